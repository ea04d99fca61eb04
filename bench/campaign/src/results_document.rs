//! The results of a campaign as a document.

use crate::bins::{Bin, short};
use crate::gates::{METRICS, Metric};
use crate::results::{
    CampaignResults, FactorResults, Map, MeanDifference, Pair, Side, VariantResults, Worst,
};
use analysis::phrase::count;
use analysis::statistics::{DIFFERING_LEAST, Discordant, Interval, MeanInterval};
use render::document::{Block, Cell, Document, Figure, Section, known, row, table};
use render::plot::{Axis, Chart, LAWS, Layer};
use render::scale::{Kind, Scale};

/// In place of the recovery time of a flight that did not recover.
const NOT_RECOVERED: &str = "not recovered";
/// Factors that are drawn at the most: those that matter least are in the table alone.
const DRAWN: usize = 12;

/// The document; `directory` is named in the command that flies the worst flights again.
pub fn document(results: &CampaignResults, directory: &str) -> Document {
    let (name, planned) = (&results.name, results.planned);
    let flights = count(results.flights, "flight");
    let part = (results.flights != planned).then(|| format!(" of {planned}"));
    let part = part.unwrap_or_default();
    let arms = count(results.arms.len() as u64, "arm");
    let sections = [
        Some(successes(results)),
        pairs(results),
        factors(results),
        maps(results),
        Some(distributions(results)),
        Some(worst(results, directory)),
    ];
    Document {
        title: format!("{name}: a campaign of {flights}"),
        heading: name.clone(),
        build: results.build.clone(),
        lead: vec![
            Block::Paragraph(format!("{name}: {flights}{part}, each by {arms}")),
            Block::Note(format!("Fingerprint {}", results.campaign)),
        ],
        sections: sections.into_iter().flatten().collect(),
        ..Document::default()
    }
}

fn keys(results: &CampaignResults) -> Vec<(&'static str, String)> {
    let names = results.arms.iter().map(|arm| arm.name.clone());
    LAWS.into_iter().cycle().zip(names).collect()
}

/// A share with as many digits as it needs near 0 and 1.
fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    let nearest = percent.min(100.0 - percent);
    let digits = if nearest == 0.0 {
        0
    } else {
        (1 - nearest.log10().floor() as i32).clamp(1, 5) as usize
    };
    format!("{percent:.digits$} %")
}

fn percents(interval: &Interval) -> String {
    format!("{} to {}", percent(interval.low), percent(interval.high))
}

fn successes(results: &CampaignResults) -> Section {
    let rows = results.arms.iter().map(|arm| {
        let rate = arm.successes as f64 / arm.flights.max(1) as f64;
        let failed = arm.gates.iter().filter(|gate| gate.held < gate.asked);
        let failed = failed.map(|gate| format!("{}: {}", gate.name, gate.asked - gate.held));
        let failed = failed.collect::<Vec<_>>().join(", ");
        let of = format!("{} of {}", arm.successes, arm.flights);
        let (rate, interval) = (percent(rate), percents(&arm.interval));
        row([&arm.name, &of, &rate, &interval, &arm.lost, &failed])
    });
    let columns = "arm;successes;rate;interval;lost;gates that failed".split(';');
    let note = "A lost flight was not flown to its end within its envelope.";
    let mut blocks = vec![Block::Note(note.into()), table(columns, rows)];
    blocks.extend(conclusion(results).map(Block::Paragraph));
    let title = format!("Success, with its {} interval at 95 %", results.intervals);
    Section::new("success", title, blocks)
}

/// Which arms succeed most often, and which might be as good.
fn conclusion(results: &CampaignResults) -> Option<String> {
    let rate = |arm: &VariantResults| arm.successes as f64 / arm.flights.max(1) as f64;
    let most = results.arms.iter().map(rate).max_by(f64::total_cmp)?;
    let (best, others): (Vec<_>, Vec<_>) = results.arms.iter().partition(|arm| rate(arm) == most);
    let names = |arms: &[&VariantResults]| {
        let names: Vec<&str> = arms.iter().map(|arm| arm.name.as_str()).collect();
        names.join(", ")
    };
    let mut as_good = others.clone();
    as_good.retain(|arm| {
        best.iter()
            .any(|best| arm.interval.high >= best.interval.low)
    });
    let shown = match (&others[..], &as_good[..]) {
        _ if results.arms.len() == 1 => return None,
        ([], _) => "with no difference between them".to_owned(),
        (_, []) => "above all others".to_owned(),
        (_, as_good) => format!("not shown to be above {}", names(as_good)),
    };
    let (best, rate) = (names(&best), percent(most));
    Some(format!(
        "Most successful: {best} with {rate}, {shown} by these intervals; pairs tell more."
    ))
}

fn pairs(results: &CampaignResults) -> Option<Section> {
    if results.pairs.is_empty() {
        return None;
    }
    let items = results.pairs.iter().map(|pair| {
        let Pair { first, second, .. } = pair;
        let MeanInterval { mean, interval, .. } = pair.difference;
        let [mean, low, high] = [mean, interval.low, interval.high].map(|share| 100.0 * share);
        let Discordant { first: one, second: other } = pair.discordant;
        let p = short(pair.p_value);
        format!(
            "{first} - {second}: success {mean:+.2} points ({low:+.2} to {high:+.2}); {first} alone succeeded in {}, \
             {second} alone in {other}, p = {p}",
            count(one, "flight")
        )
    });
    let means = results.pairs.iter().flat_map(|pair| {
        // What is the same in every flight is left out.
        let differs =
            |it: &MeanDifference| it.of.differing > 0 || it.of.mean != 0.0 || it.missing != [0, 0];
        let metrics = pair.metrics.iter();
        let metrics = metrics.filter(move |metric| differs(&metric.is));
        metrics.map(move |metric| {
            let MeanDifference { of: it, missing } = &metric.is;
            let name = format!("{} - {}", pair.first, pair.second);
            let interval = match it.interval {
                Some(Interval { low, high }) => format!("{} to {}", short(low), short(high)),
                None => format!("none: {} of {} differ", it.differing, it.count),
            };
            let left_out = match missing {
                [0, 0] => String::new(),
                [first, second] => format!(" ({NOT_RECOVERED}: {first} and {second})"),
            };
            let flights = format!("{}{left_out}", it.count);
            row([&name, &metric.name, &short(it.mean), &interval, &flights])
        })
    });
    let columns = ["mean difference", "metric", "mean", "interval", "flights"];
    let note = format!(
        "Both arms of a pair flew the same draws. p is McNemar's: how probable so uneven a split is, were both alike. Its \
         interval is Bonett and Price's, at 95 %. Means are over the flights that neither lost, with bootstrap-t \
         intervals at 95 %; there is none if fewer than {DIFFERING_LEAST} flights differ from the most frequent value. \
         The mean difference of a recovery time is over the flights in which both recovered."
    );
    let blocks = vec![
        Block::Items(items.collect()),
        table(columns, means),
        Block::Note(note),
    ];
    let title = "Arms on the same draws: first less second";
    Some(Section::new("pairs", title, blocks))
}

fn rate(bin: &Bin) -> f64 {
    bin.successes as f64 / bin.flights.max(1) as f64
}

fn factors(results: &CampaignResults) -> Option<Section> {
    if results.factors.is_empty() {
        return None;
    }
    let share = |share: Option<f64>| known(share.map(|share| format!("{:.1} %", 100.0 * share)));
    let arms = || results.arms.iter();
    let rows = results.factors.iter().flat_map(|factor| {
        arms().zip(&factor.arms).map(|(arm, effect)| {
            let flown = || effect.bins.iter().filter(|bin| bin.flights > 0);
            let by_rate = |a: &&Bin, b: &&Bin| rate(a).total_cmp(&rate(b));
            let ends = flown().min_by(by_rate).zip(flown().max_by(by_rate));
            let ends = ends.filter(|(least, most)| rate(least) < rate(most));
            let at = |bin: &Bin| format!("{:.0} % at {}", 100.0 * rate(bin), bin.name);
            let spread = ends.map(|(least, most)| format!("{}, {}", at(least), at(most)));
            let [success, error] = [effect.of_success, effect.of_error].map(share);
            row([&factor.name, &arm.name, &success, &error, &known(spread)])
        })
    });
    let columns = "factor;arm;success;log of largest error;success from, to".split(';');
    let note = "Share of the variance that a factor alone accounts for, less what it would by chance; below, success over \
                its range.";
    let mut blocks = vec![table(columns, rows), Block::Note(note.into())];
    let drawn = || results.factors.iter().take(DRAWN);
    let figures = drawn().filter_map(|factor| over(results, factor));
    blocks.push(Block::Figures(figures.collect()));
    for factor in drawn().filter(|factor| ranges(factor).is_empty()) {
        let values = factor.arms.first().map_or(0, |it| it.bins.len());
        let rows = (0..values).map(|i| {
            let bins = || factor.arms.iter().filter_map(|effect| effect.bins.get(i));
            let name = bins().next().map(|bin| word(&bin.name).to_owned());
            let rate = |bin: &Bin| format!("{} ({})", percent(rate(bin)), percents(&bin.interval));
            let cells = name.into_iter().chain(bins().map(rate));
            cells.map(Cell::from).collect()
        });
        let names = arms().map(|arm| arm.name.as_str());
        let columns = [factor.name.as_str()].into_iter().chain(names);
        let title = format!("Success over {}", factor.name);
        blocks.push(Block::Details(title, vec![table(columns, rows)]));
    }
    let title = "What matters: share of the variance of success (of the logarithm of the largest error) that a factor alone accounts for";
    Some(Section::new("factors", title, blocks))
}

/// The ranges of a factor of numbers; none of one of words.
fn ranges(factor: &FactorResults) -> Vec<[f64; 2]> {
    let bins = factor.arms.iter().flat_map(|it| &it.bins);
    bins.filter_map(|bin| bin.range).collect()
}

fn over(results: &CampaignResults, factor: &FactorResults) -> Option<Figure> {
    let ranges = ranges(factor);
    let ends = || ranges.iter().flatten().copied();
    let low = ends().reduce(f64::min)?;
    let high = ends().fold(low, f64::max);
    let is_log = low > 0.0 && high / low > 20.0;
    let x = match is_log {
        true => Scale::new(Kind::Log, low, high),
        false => Scale::time(low, high),
    };
    let middle = |[low, high]: [f64; 2]| match is_log {
        true => (low * high).sqrt(),
        false => (low + high) / 2.0,
    };
    let mut layers = Vec::new();
    for (class, effect) in LAWS.into_iter().cycle().zip(&factor.arms) {
        let bins = effect.bins.iter().filter(|bin| bin.flights > 0);
        let bins: Vec<(f64, &Bin)> = bins
            .filter_map(|bin| Some((middle(bin.range?), bin)))
            .collect();
        let points = bins.iter().map(|(x, bin)| (*x, 100.0 * rate(bin)));
        let points = points.collect();
        layers.push(Layer::Line(class, points));
        for (x, bin) in bins {
            let ends = [bin.interval.low, bin.interval.high];
            let points = ends.map(|end| (x, 100.0 * end)).into();
            layers.push(Layer::Line(class, points));
        }
    }
    let label = match factor.name.starts_with("fault.") {
        true => &factor.meaning,
        false => &factor.name,
    };
    let x = Axis::new(x, label);
    let y = Axis::new(Scale::time(0.0, 105.0), "success [%]");
    let chart = Chart::new(format!("success over {}", factor.name), x, y, layers);
    let keys = keys(results);
    Some(Figure::new(&factor.name, &factor.meaning, keys, chart))
}

/// A drawn value that is a list of one word, as that word.
fn word(name: &str) -> &str {
    let word = name.strip_prefix("[\"");
    word.and_then(|it| it.strip_suffix("\"]")).unwrap_or(name)
}

fn maps(results: &CampaignResults) -> Option<Section> {
    if results.maps.is_empty() {
        return None;
    }
    let note = "The darker, the more flights failed; the number is the share of successes [%].";
    let maps = results.maps.iter().map(heat);
    let blocks = [Block::Note(note.into())].into_iter().chain(maps).collect();
    Some(Section::new("maps", "Success over two factors", blocks))
}

fn heat(map: &Map) -> Block {
    // What has the longer names goes down: a column is narrow.
    let longest = |side: &Side| side.bins.iter().map(String::len).max().unwrap_or_default();
    let is_turned = longest(&map.x) > longest(&map.y);
    let (across, down) = match is_turned {
        true => (&map.y, &map.x),
        false => (&map.x, &map.y),
    };
    let cell = |row: usize, column: usize| {
        let [successes, flights] = match is_turned {
            true => map.cells[column][row],
            false => map.cells[row][column],
        };
        let percent = (flights > 0).then(|| 100.0 * successes as f64 / flights as f64);
        Cell {
            shade: Some(0.85 * percent.map_or(0.0, |percent| 100.0 - percent)),
            ..known(percent.map(|percent| format!("{percent:.0}"))).into()
        }
    };
    let rows = down.bins.iter().enumerate().map(|(i, name)| {
        let cells = (0..across.bins.len()).map(|column| cell(i, column));
        [word(name).into()].into_iter().chain(cells).collect()
    });
    let names = across.bins.iter().map(|name| word(name));
    let columns = [""].into_iter().chain(names);
    let (across, down) = (&across.factor, &down.factor);
    let title = format!("{}: {across} across, {down} down", map.arm);
    Block::Details(title, vec![table(columns, rows)])
}

fn distributions(results: &CampaignResults) -> Section {
    // What is the same in every flight is left out.
    let varies = |i: &usize| {
        let mut metrics = results.arms.iter().map(|arm| &arm.metrics[*i].is);
        metrics.any(|it| it.min < it.max || it.missing > 0)
    };
    let varying: Vec<usize> = (0..METRICS.len()).filter(varies).collect();
    let rows = varying.iter().flat_map(|i| {
        let arms = results.arms.iter();
        let known = arms.filter(|arm| !arm.metrics[*i].is.quantiles.is_empty());
        known.map(move |arm| quantiles(METRICS[*i].name, arm, *i))
    });
    let columns = ["metric", "arm", "quantiles", "max", "flights"];
    let note = "The share of flights that a value is not exceeded in; the axis is logarithmic in 1 - p. Flights that did not \
         recover have the largest recovery time: a curve ends where they begin.";
    let figure = |i: &usize| distribution(results, *i, &METRICS[*i]);
    let figures = varying.iter().map(figure).collect();
    let blocks = vec![
        table(columns, rows),
        Block::Note(note.into()),
        Block::Figures(figures),
    ];
    Section::new("metrics", "Distributions", blocks)
}

fn quantiles(name: &str, arm: &VariantResults, metric: usize) -> Vec<Cell> {
    let it = &arm.metrics[metric].is;
    let quantiles = it.quantiles.iter();
    let value = |value: Option<f64>| value.map_or_else(|| NOT_RECOVERED.into(), short);
    let quantiles = quantiles.map(|q| {
        let percent = (1e4 * q.share).round() / 1e2;
        format!("p{percent} {}", value(q.value))
    });
    let quantiles = quantiles.collect::<Vec<_>>().join("  ");
    let flights = match it.missing {
        0 => it.count.to_string(),
        missing => format!("{}, {missing} {NOT_RECOVERED}", it.count + missing),
    };
    row([&name, &arm.name, &quantiles, &value(it.max), &flights])
}

fn distribution(results: &CampaignResults, place: usize, metric: &Metric) -> Figure {
    let curves = || results.arms.iter().map(|arm| &arm.metrics[place].is.curve);
    let values = || curves().flatten().filter_map(|point| point.value);
    let smallest = values().fold(f64::INFINITY, f64::min);
    let largest = values().fold(0.0, f64::max);
    let y = match smallest > 0.0 && largest / smallest > 20.0 {
        true => Scale::log(values()),
        false => Scale::linear(values(), 1e-9),
    };
    let shares = curves().filter_map(|curve| Some(curve.last()?.share));
    let x = Scale::tail(shares.fold(0.0, f64::max));
    let layers = LAWS.into_iter().cycle().zip(curves());
    let layers = layers.map(|(class, curve)| {
        let points = curve.iter();
        let points = points.filter_map(|point| Some((point.share, point.value?)));
        let points = points.collect();
        Layer::Line(class, points)
    });
    let label = match metric.unit {
        "" => metric.name.to_owned(),
        unit => format!("{} [{unit}]", metric.name),
    };
    let chart = Chart::new(
        format!("distribution of {}", metric.name),
        Axis::new(x, "share of flights [%]"),
        Axis::new(y, label),
        layers.collect(),
    );
    Figure::new(metric.name, metric.meaning, keys(results), chart)
}

fn worst(results: &CampaignResults, directory: &str) -> Section {
    // A drawn number in few digits.
    let drawn = |value: &str| value.parse().map_or_else(|_| value.to_owned(), short);
    let rows = results.worst.iter().map(|it| {
        let drew = it.drew.iter().filter(|(name, _)| name != "flight.seed");
        let drew = drew.map(|(name, value)| format!("{name}={}", drawn(value)));
        let drew = drew.collect::<Vec<_>>().join(" ");
        let how = match (it.lost.is_empty(), it.success) {
            (false, _) => format!("lost: {}", it.lost),
            (true, false) => "failed".into(),
            (true, true) => "success".into(),
        };
        let error_m = short(it.position_error_max_m);
        row([&it.flight, &it.arm, &error_m, &how, &drew])
    });
    let columns = ["flight", "arm", "largest error [m]", "how it ended", "drew"];
    let mut blocks = vec![table(columns, rows)];
    if let Some(Worst { flight, arm, .. }) = results.worst.first() {
        let command = format!("ironbird campaign fly {directory} {flight} --arm {arm}");
        blocks.push(Block::Items(vec![format!("fly one again: {command}")]));
    }
    Section::new("worst", "Worst flights", blocks)
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_share_has_more_digits_near_0_and_1() {
        let percents = [0.001, 0.5, 0.9995].map(super::percent);
        assert_eq!(percents, ["0.10 %", "50.0 %", "99.950 %"]);
    }
}
