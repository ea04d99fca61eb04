//! What a campaign has shown, as one self-contained web page.

use crate::bins::{Bin, short};
use crate::gates::{METRICS, Metric};
use crate::metric_distribution::Distribution;
use crate::results::{CampaignResults, FactorResults, Map, Of, Side};
use crate::results_text::{drawn, percent};
use maud::{Markup, html};
use report::render::html::{Key, cell, chart, figure, section, table};
use report::render::page::document;
use report::render::plot::{Axis, Chart, HEIGHT, Layer};
use report::render::scale::Scale;

/// Colours of arms: six, and the same once more as broken lines. More arms begin again.
const CLASSES: [&str; 12] = [
    "law-1", "law-2", "law-3", "law-4", "law-5", "law-6", "law-7", "law-8", "law-9", "law-10",
    "law-11", "law-12",
];
/// Factors that are drawn at the most: those that matter least are in the table alone.
const DRAWN: usize = 12;

#[must_use]
pub fn render(findings: &CampaignResults) -> String {
    let CampaignResults {
        name,
        flights,
        planned,
        arms,
        build,
        ..
    } = findings;
    document(
        &format!("{name}: a campaign of {flights} flights"),
        build,
        html! {
            header {
                h1 { (name) }
                p {
                    (flights) " flights" @if flights != planned { " of " (planned) } ", each by "
                    (crate::results::counted(arms.len(), "arm")) ". Fingerprint " code { (findings.campaign) } "."
                }
            }
            main {
                (section("success", "Success", successes(findings)))
                @if !findings.pairs.is_empty() { (section("pairs", "Arms on the same draws", pairs(findings))) }
                @if !findings.factors.is_empty() { (section("factors", "What matters", factors(findings))) }
                @if !findings.maps.is_empty() { (section("maps", "Success over two factors", maps(findings))) }
                (section("metrics", "Distributions", distributions(findings)))
                (section("worst", "Worst flights", worst(findings)))
                @if let Some(audit) = &findings.audit {
                    (section("audit", "Audit", html! {
                        p { (audit.words()) "." }
                        ul { @for it in &audit.differences { li { (it.words()) } } }
                    }))
                }
            }
            footer { "ironbird " (build) }
        },
    )
}

fn keys(findings: &CampaignResults) -> Vec<Key<'_>> {
    CLASSES
        .into_iter()
        .cycle()
        .zip(findings.arms.iter().map(|arm| arm.name.as_str()))
        .collect()
}

fn successes(findings: &CampaignResults) -> Markup {
    let rows = findings.arms.iter().map(|arm| {
        let rate = arm.successes as f64 / arm.flights.max(1) as f64;
        let failed = arm.gates.iter().filter(|gate| gate.held < gate.asked);
        let failed: Vec<String> = failed
            .map(|gate| format!("{}: {}", gate.name, gate.asked - gate.held))
            .collect();
        let interval = format!(
            "{} to {}",
            percent(arm.interval.low),
            percent(arm.interval.high)
        );
        let of = format!("{} of {}", arm.successes, arm.flights);
        [
            arm.name.clone(),
            of,
            percent(rate),
            interval,
            arm.lost.to_string(),
            failed.join(", "),
        ]
        .map(cell)
        .into()
    });
    html! {
        p {
            "Intervals are " (findings.intervals) "'s, at 95 %. A lost flight was not flown to its end within its "
            "envelope."
        }
        (table(&["arm", "successes", "rate", "interval", "lost", "gates that failed"], rows))
    }
}

fn pairs(findings: &CampaignResults) -> Markup {
    let rows = findings.pairs.iter().map(|pair| {
        let it = pair.difference;
        let points = |share: f64| format!("{:+.2}", 100.0 * share);
        let split = format!("{} : {}", pair.discordant.first, pair.discordant.second);
        let name = format!("{} - {}", pair.first, pair.second);
        let interval = format!(
            "{} to {}",
            points(it.interval.low),
            points(it.interval.high)
        );
        [name, points(it.mean), interval, split, short(pair.p_value)]
            .map(cell)
            .into()
    });
    let means = findings.pairs.iter().flat_map(|pair| {
        // What is the same in every flight says nothing.
        let differ = pair
            .metrics
            .iter()
            .filter(|metric| metric.is.interval.low != 0.0 || metric.is.interval.high != 0.0);
        differ.map(
            move |Of {
                      name: metric,
                      is: it,
                  }| {
                let name = format!("{} - {}", pair.first, pair.second);
                let interval = format!("{} to {}", short(it.interval.low), short(it.interval.high));
                [
                    name,
                    metric.clone(),
                    short(it.mean),
                    interval,
                    it.count.to_string(),
                ]
                .map(cell)
                .into()
            },
        )
    });
    html! {
        p {
            "Both arms of a pair flew the same draws. p is McNemar's: how probable so uneven a split is, were both "
            "alike."
        }
        (table(&["first - second", "success [points]", "interval", "flights that one alone flew", "p"], rows))
        p { "Mean differences over the flights that neither lost, with bootstrap intervals at 95 %." }
        (table(&["first - second", "metric", "mean difference", "interval", "flights"], means))
    }
}

fn factors(findings: &CampaignResults) -> Markup {
    let share = |share: Option<f64>| {
        share.map_or_else(|| "-".into(), |share| format!("{:.1}", 100.0 * share))
    };
    let columns: Vec<String> = findings
        .arms
        .iter()
        .flat_map(|arm| {
            [
                format!("{}: success [%]", arm.name),
                format!("{}: largest error [%]", arm.name),
            ]
        })
        .collect();
    let columns: Vec<&str> = ["factor"]
        .into_iter()
        .chain(columns.iter().map(String::as_str))
        .collect();
    let rows = findings.factors.iter().map(|factor| {
        let shares = factor
            .arms
            .iter()
            .flat_map(|it| [share(it.of_success), share(it.of_error)]);
        [factor.name.clone()]
            .into_iter()
            .chain(shares)
            .map(cell)
            .collect()
    });
    let keys = keys(findings);
    html! {
        p {
            "Share of the variance that a factor alone accounts for, less what it would by chance; below, success "
            "over its range."
        }
        (table(&columns, rows))
        div.plots {
            @for factor in findings.factors.iter().take(DRAWN) { (over(findings, factor, &keys)) }
        }
    }
}

/// Success over a factor: a chart of numbers, a table of words.
fn over(findings: &CampaignResults, factor: &FactorResults, keys: &[Key<'_>]) -> Markup {
    let ranges: Vec<[f64; 2]> = factor
        .arms
        .iter()
        .flat_map(|it| it.bins.iter().filter_map(|bin| bin.range))
        .collect();
    if ranges.is_empty() {
        let columns: Vec<&str> = ["value"]
            .into_iter()
            .chain(findings.arms.iter().map(|arm| arm.name.as_str()))
            .collect();
        let rate = |bin: &Bin| {
            format!(
                "{} ({} to {})",
                percent(rate(bin)),
                percent(bin.interval.low),
                percent(bin.interval.high)
            )
        };
        let values = factor.arms.first().map_or(0, |it| it.bins.len());
        let rows = (0..values).map(|i| {
            let bins = || factor.arms.iter().filter_map(|effect| effect.bins.get(i));
            let name = bins()
                .next()
                .map_or_else(String::new, |bin| word(&bin.name).to_owned());
            [name]
                .into_iter()
                .chain(bins().map(rate))
                .map(cell)
                .collect()
        });
        // As wide as the page: words are longer than numbers.
        return html! {
            div style="grid-column: 1 / -1" { (figure(&factor.name, &factor.name, &[], table(&columns, rows))) }
        };
    }
    let ends = ranges.iter().flatten().copied();
    let (low, high) = ends.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), it| {
        (low.min(it), high.max(it))
    });
    let is_log = low > 0.0 && high / low > 20.0;
    let x = if is_log {
        Scale::Log { low, high }
    } else {
        Scale::Linear {
            low,
            high: high.max(low + 1e-12),
        }
    };
    let middle = |[low, high]: [f64; 2]| {
        if is_log {
            (low * high).sqrt()
        } else {
            (low + high) / 2.0
        }
    };
    let mut layers = Vec::new();
    for ((class, _), effect) in keys.iter().zip(&factor.arms) {
        let class = CLASSES
            .into_iter()
            .find(|known| known == class)
            .unwrap_or(CLASSES[0]);
        let bins = effect.bins.iter().filter(|bin| bin.flights > 0);
        let points: Vec<(f64, &Bin)> = bins
            .filter_map(|bin| Some((middle(bin.range?), bin)))
            .collect();
        layers.push(Layer::Line {
            class,
            points: points
                .iter()
                .map(|(x, bin)| (*x, 100.0 * rate(bin)))
                .collect(),
        });
        for (x, bin) in points {
            let ends = [bin.interval.low, bin.interval.high].map(|end| (x, 100.0 * end));
            layers.push(Layer::Line {
                class,
                points: ends.into(),
            });
        }
    }
    let drawn = Chart {
        title: format!("success over {}", factor.name),
        x: Axis::new(x, factor.name.clone()),
        y: Axis::new(
            Scale::Linear {
                low: 0.0,
                high: 105.0,
            },
            "success [%]",
        ),
        lanes: Vec::new(),
        layers,
        height: HEIGHT,
    };
    chart(&factor.name, &factor.meaning, keys, &drawn)
}

/// Whether a bin's name is one word, which may be long, and not a range, which breaks at its blanks.
fn is_word(name: &str) -> bool {
    !name.contains(' ')
}

/// A drawn value that is a list of one word, as that word.
fn word(name: &str) -> &str {
    name.strip_prefix("[\"")
        .and_then(|it| it.strip_suffix("\"]"))
        .unwrap_or(name)
}

fn rate(bin: &Bin) -> f64 {
    bin.successes as f64 / bin.flights.max(1) as f64
}

fn maps(findings: &CampaignResults) -> Markup {
    html! {
        p { "The darker, the more flights failed; the number is the share of successes [%]." }
        div.plots { @for (i, map) in findings.maps.iter().enumerate() { (heat(i, map)) } }
    }
}

/// A map as a table of shaded cells.
fn heat(number: usize, map: &Map) -> Markup {
    // What has the longer names goes down: a column is narrow.
    let longest = |side: &Side| side.bins.iter().map(String::len).max().unwrap_or_default();
    let is_turned = longest(&map.x) > longest(&map.y);
    let (across, down) = if is_turned {
        (&map.y, &map.x)
    } else {
        (&map.x, &map.y)
    };
    let counts = |row: usize, column: usize| {
        if is_turned {
            map.cells[column][row]
        } else {
            map.cells[row][column]
        }
    };
    let title = format!(
        "{}: {} across, {} down",
        map.arm, across.factor, down.factor
    );
    let cell = |[successes, flights]: [u64; 2], column: &String| {
        let percent = 100.0 * successes as f64 / flights.max(1) as f64;
        let shade = if flights == 0 {
            0.0
        } else {
            0.85 * (100.0 - percent)
        };
        html! {
            td data-column=(column) style=(format!("min-width:0;background:rgb(213 94 0 / {shade:.0}%)"))
                title=(format!("{successes} of {flights}")) {
                @if flights == 0 { "-" } @else { (format!("{percent:.0}")) }
            }
        }
    };
    figure(
        &format!("map-{number}"),
        &title,
        &[],
        html! {
            table {
                thead { tr { th {} @for name in &across.bins { th { (word(name)) } } } }
                tbody {
                    @for (row, name) in down.bins.iter().enumerate() {
                        tr {
                            th scope="row" style=[is_word(name).then_some("overflow-wrap:anywhere")] { (word(name)) }
                            @for (column, name) in across.bins.iter().enumerate() { (cell(counts(row, column), name)) }
                        }
                    }
                }
            }
        },
    )
}

fn distributions(findings: &CampaignResults) -> Markup {
    let varies = |i: &usize| {
        findings
            .arms
            .iter()
            .any(|arm| arm.metrics[*i].is.min < arm.metrics[*i].is.max)
    };
    html! {
        p { "The share of flights that a value is not exceeded in; each nine takes as much space." }
        div.plots {
            @for i in (0..METRICS.len()).filter(varies) { (distribution(findings, i, &METRICS[i])) }
        }
    }
}

fn distribution(findings: &CampaignResults, place: usize, metric: &Metric) -> Markup {
    let keys = keys(findings);
    let known: Vec<(&'static str, &Distribution)> = CLASSES
        .into_iter()
        .cycle()
        .zip(findings.arms.iter().map(|arm| &arm.metrics[place].is))
        .collect();
    let values = || {
        known
            .iter()
            .flat_map(|(_, it)| it.curve.iter().map(|point| point.value))
    };
    let smallest = values().fold(f64::INFINITY, f64::min);
    let largest = values().fold(0.0, f64::max);
    let is_log = smallest > 0.0 && largest / smallest > 20.0;
    let y = if is_log {
        Scale::log(values())
    } else {
        Scale::linear(values(), 1e-9)
    };
    let share = known
        .iter()
        .filter_map(|(_, it)| it.curve.last())
        .map(|point| point.share)
        .fold(0.0, f64::max);
    let layers = known.iter().map(|(class, it)| Layer::Line {
        class,
        points: it
            .curve
            .iter()
            .map(|point| (point.share, point.value))
            .collect(),
    });
    let unit = if metric.unit.is_empty() {
        String::new()
    } else {
        format!(" [{}]", metric.unit)
    };
    let drawn = Chart {
        title: format!("distribution of {}", metric.name),
        x: Axis::new(Scale::tail(share), "share of flights [%]"),
        y: Axis::new(y, format!("{}{unit}", metric.name)),
        lanes: Vec::new(),
        layers: layers.collect(),
        height: HEIGHT,
    };
    chart(metric.name, metric.meaning, &keys, &drawn)
}

fn worst(findings: &CampaignResults) -> Markup {
    let rows = findings.worst.iter().map(|it| {
        let drew: Vec<String> = it
            .drew
            .iter()
            .map(|(name, value)| format!("{name} = {}", drawn(value)))
            .collect();
        let how = if it.lost.is_empty() {
            if it.success { "success" } else { "failed" }.to_owned()
        } else {
            it.lost.clone()
        };
        [
            it.flight.to_string(),
            it.arm.clone(),
            short(it.position_error_max_m),
            how,
            drew.join(", "),
        ]
        .map(cell)
        .into()
    });
    html! {
        p { code { "ironbird campaign fly DIR FLIGHT --arm ARM" } " flies one again, with its log and its page." }
        (table(&["flight", "arm", "largest error [m]", "how it ended", "drew"], rows))
    }
}
