//! Robustness margins: a row or a line per combination of laws for each question.

use crate::comparison::millimetres;
use crate::document::{Block, Document, Figure, Section, Table, known};
use crate::plot::{Axis, Chart, LAWS, Layer};
use crate::scale::Scale;
use analysis::margin::{
    LawMargins, Margins, OutageMargin, Point, SATURATED, SATURATED_MORE_PERCENT, SMALLEST_BOUND_M,
    SteadyMargin,
};
use analysis::phrase::count;

/// Errors below are drawn as this [m].
const ERROR_MIN_M: f64 = 1e-4;

pub fn document(margins: &Margins) -> Document {
    let survived = format!("survived: {}", criteria(margins));
    let lead = [conditions(margins), phases(margins), survived];
    let sections = [
        unfaulted(margins),
        outages(margins),
        lateness(margins),
        losses(margins),
        patterns(margins),
        exceptions(margins),
    ];
    Document {
        title: format!("margins, {}", conditions(margins)),
        heading: "Robustness of the loop".into(),
        build: margins.build.to_string(),
        lead: lead.map(Block::Paragraph).into(),
        sections: sections.into_iter().flatten().collect(),
        footer: ". Each flight is one of `ironbird simulate --fault`.".into(),
        ..Document::default()
    }
}

fn conditions(margins: &Margins) -> String {
    let (trajectory, preset) = (&margins.trajectory, &margins.preset);
    let (airframe, seed) = (&margins.airframe, margins.seed);
    format!("trajectory {trajectory}, gains {preset}, airframe {airframe}, seed {seed}")
}

fn phases(margins: &Margins) -> String {
    let first_s = margins.phases_s.first().copied().unwrap_or_default();
    let of = match margins.cycle_s {
        Some(cycle_s) if margins.span_s < cycle_s - margins.period_s => {
            format!(" of {cycle_s:.3} s after which the trajectory repeats")
        }
        Some(_) => ", one period of the trajectory".into(),
        None => ", of a trajectory that does not repeat".into(),
    };
    let phases = count(margins.phases_s.len() as u64, "phase");
    let span_s = margins.span_s;
    format!("{phases} over {span_s:.3} s from {first_s:.3} s on{of}")
}

fn criteria(margins: &Margins) -> String {
    let (limits, recovery_max_s) = (&margins.gate.limits, margins.gate.recovery_max_s);
    let tracked_below_m = margins.gate.tracked_below_m;
    let below = match margins.gate.recovered_below_m {
        Some(bound_m) => format!("{bound_m} m"),
        None => format!(
            "twice the largest error without a fault and at least {SMALLEST_BOUND_M} m, under a steady fault \
             {tracked_below_m} m"
        ),
    };
    let saturated = match limits.iter().any(|(name, _)| name == SATURATED) {
        true => String::new(),
        false => format!(
            "; under a steady fault saturated in at most {SATURATED_MORE_PERCENT} % more of the ticks"
        ),
    };
    let more = limits.iter();
    let more: String = more
        .map(|(name, most)| format!("; {name} up to {most}"))
        .collect();
    format!(
        "envelope kept, position error below {below} within {recovery_max_s} s and for at least 1 s{saturated}{more}"
    )
}

fn table(
    margins: &Margins,
    columns: &[impl ToString],
    cells: impl Fn(&LawMargins) -> Vec<String>,
) -> Block {
    let rows = margins.laws.iter();
    let rows = rows.map(|law| (margins.name_of(&law.laws), cells(law)));
    let columns = columns.iter().map(ToString::to_string);
    Block::Table(Table::named("laws", columns, rows))
}

/// A number of ticks, or that the longest that was tried was survived.
fn ticks(ticks: u64, margins: &Margins) -> String {
    match ticks >= margins.longest_ticks {
        true => format!("> {ticks}"),
        false => ticks.to_string(),
    }
}

fn ticks_of(margins: &Margins) -> String {
    format!("[ticks of {} ms]", margins.period_s * 1e3)
}

fn inputs<T>(
    margins: &Margins,
    of: fn(&LawMargins) -> &[T],
    name: fn(&T) -> &String,
) -> Vec<String> {
    let first = margins.laws.first().into_iter();
    first.flat_map(of).map(name).cloned().collect()
}

fn sparse(margins: &Margins) -> String {
    let phases = margins.phases_s.len().div_ceil(margins.sparse);
    count(phases as u64, "phase")
}

fn keys(margins: &Margins) -> Vec<(&'static str, String)> {
    let names = margins.laws.iter().map(|law| margins.name_of(&law.laws));
    LAWS.into_iter().zip(names).collect()
}

fn unfaulted(margins: &Margins) -> Option<Section> {
    let columns = [
        "error [mm]",
        "saturated [%]",
        "recovered below [mm]",
        "flights",
    ];
    let table = table(margins, &columns, |law| {
        let saturated = format!("{:.1}", law.unfaulted_saturated_percent);
        let error = millimetres(law.unfaulted_error_m);
        let below = millimetres(law.recovered_below_m);
        vec![error, saturated, below, law.flights.to_string()]
    });
    Some(Section::new("unfaulted", "Without a fault", vec![table]))
}

fn outages(margins: &Margins) -> Option<Section> {
    let of = inputs(margins, |law| &law.outages, |it| &it.of);
    if of.is_empty() {
        return None;
    }
    let figure = |(i, name): (usize, &String)| {
        let chart = outage_chart(margins, i, name);
        Figure::new(format!("outage-{i}"), name, keys(margins), chart)
    };
    let note = format!(
        "The longest outage that a flight survived, by when it began. A stage that is out works nothing; machine is all \
         four at once; an input as inner.state loses all messages. Outages of more than {} ticks were not tried.",
        margins.longest_ticks
    );
    let mut blocks = vec![
        Block::Note(note),
        Block::WideFigures(of.iter().enumerate().map(figure).collect()),
    ];
    let phases = count(margins.phases_s.len() as u64, "phase");
    for (title, is_input) in [
        ("Longest outage survived", false),
        ("Longest loss of all messages survived", true),
    ] {
        let is_it = |of: &str| of.contains('.') == is_input;
        let columns: Vec<&String> = of.iter().filter(|of| is_it(of)).collect();
        if columns.is_empty() {
            continue;
        }
        let cell = |it: &OutageMargin| {
            let [least, median] = [it.least(), it.median()].map(|it| ticks(it, margins));
            format!("{least} / {median}")
        };
        let title = format!("{title} {}: least / median of {phases}", ticks_of(margins));
        blocks.push(Block::Heading(title));
        let cells = |law: &LawMargins| {
            let outages = law.outages.iter().filter(|it| is_it(&it.of));
            outages.map(cell).collect()
        };
        blocks.push(table(margins, &columns, cells));
    }
    Some(Section::new("outage", "Outages", blocks))
}

fn outage_chart(margins: &Margins, i: usize, name: &str) -> Chart {
    let mut values = Vec::new();
    let line = |(law, class): (&LawMargins, &'static str)| {
        let ticks = law.outages.get(i)?.ticks.iter();
        let ticks = ticks.map(|ticks| (*ticks as f64).max(0.5));
        values.extend(ticks.clone());
        let points = margins.phases_s.iter().copied().zip(ticks).collect();
        Some(Layer::Line(class, points))
    };
    let layers = margins.laws.iter().zip(LAWS).filter_map(line).collect();
    let first_s = margins.phases_s.first().copied().unwrap_or_default();
    let x = Scale::time(first_s, first_s + margins.span_s);
    let x = Axis::new(x, "begin of the outage [s]");
    let y = Axis::new(Scale::log(values.into_iter()), "survived [ticks]");
    let title = format!("longest outage of {name} survived, over its begin");
    Chart::new(title, x, y, layers)
}

/// A picture per input: a line per combination through what its flights survived.
fn over(
    margins: &Margins,
    (name, label): (&str, &str),
    inputs: &[String],
    points: impl Fn(&LawMargins, usize) -> Option<&[Point]>,
    at: impl Fn(f64) -> f64,
) -> Block {
    let figure = |(i, input): (usize, &String)| {
        let mut layers = Vec::new();
        let (mut values, mut last) = (Vec::new(), 1.0_f64);
        for (law, class) in margins.laws.iter().zip(LAWS) {
            let points = points(law, i).unwrap_or_default();
            let place = |it: &Point| Some((at(it.at), it.error_m?.max(ERROR_MIN_M)));
            let line: Vec<(f64, f64)> = points.iter().map_while(place).collect();
            last = points.iter().map(|it| at(it.at)).fold(last, f64::max);
            values.extend(line.iter().map(|(_, error_m)| *error_m));
            let failed = points.iter().zip(line.clone());
            let failed = failed.filter(|(it, _)| it.survived < it.flights);
            let word = |it: &Point| format!("{} of {} flights survived", it.survived, it.flights);
            let dots = failed.map(|(it, place)| (place, word(it))).collect();
            layers.extend([Layer::Line(class, line), Layer::Dots(class, dots)]);
        }
        let x = Axis::new(Scale::time(0.0, last), label);
        let y = Scale::log(values.into_iter());
        let y = Axis::new(y, "largest error of the last 5 s [m]");
        let title = format!("largest position error over {label} of {input}");
        let chart = Chart::new(title, x, y, layers);
        Figure::new(format!("{name}-{i}"), input, keys(margins), chart)
    };
    Block::WideFigures(inputs.iter().enumerate().map(figure).collect())
}

const DOTS: &str = "A dot is where not every flight survived. A line ends where one left its envelope, or where the \
                    first phase had missed so often in a row that it was flown no further.";

fn lateness(margins: &Margins) -> Option<Section> {
    let longest = |title: String, of: fn(&LawMargins) -> &[SteadyMargin]| {
        let more = |it: &SteadyMargin| if it.is_most { " and more" } else { "" };
        let cell = |it: &SteadyMargin| format!("{}{}", it.ticks, more(it));
        let columns = inputs(margins, of, |it| &it.input);
        let table = table(margins, &columns, |law| of(law).iter().map(cell).collect());
        [
            Block::Heading(format!("{title}; least of {}", sparse(margins))),
            table,
        ]
    };
    let lags = inputs(margins, |law| &law.lags, |it| &it.input);
    if lags.is_empty() {
        return None;
    }
    let tick = ticks_of(margins);
    let name = ("lag", "lag [ticks]");
    let figures = over(
        margins,
        name,
        &lags,
        |law, i| Some(&law.lags.get(i)?.points),
        |it| it,
    );
    let mut blocks = vec![Block::Note(DOTS.into()), figures];
    let title = format!("Longest steady lag {tick}: in time, but so old (dead time)");
    blocks.extend(longest(title, |law| &law.lags));
    let title = format!("Longest steady delay {tick}: so late, and known as stale");
    blocks.extend(longest(title, |law| &law.delays));
    Some(Section::new("lateness", "Lateness", blocks))
}

fn losses(margins: &Margins) -> Option<Section> {
    let inputs = inputs(margins, |law| &law.losses, |it| &it.input);
    if inputs.is_empty() {
        return None;
    }
    let flights = count(margins.phases_s.len() as u64, "flight");
    let title = format!(
        "Largest share of random losses [%]: all of {flights} survived (of as many with other seeds: probability of \
         survival at 95 %) / half did"
    );
    let table = table(margins, &inputs, |law| {
        let each = law.losses.iter().map(|it| {
            let [low, high] = it.survival.map(|it| 100.0 * it);
            let (share, half) = (100.0 * it.share, 100.0 * it.median_share);
            let survived = format!("{} of {}: {low:.1} to {high:.0} %", it.survived, it.flights);
            format!("{share:.0} ({survived}) / {half:.0}")
        });
        each.collect()
    });
    let percent = |share: f64| 100.0 * share;
    let name = ("loss", "messages lost [%]");
    let figures = over(
        margins,
        name,
        &inputs,
        |law, i| Some(&law.losses.get(i)?.points),
        percent,
    );
    let note =
        format!("A share of the messages is lost at random, by another seed at each phase. {DOTS}");
    let blocks = vec![Block::Note(note), figures, Block::Heading(title), table];
    Some(Section::new("loss", "Losses", blocks))
}

fn patterns(margins: &Margins) -> Option<Section> {
    let inputs = inputs(margins, |law| &law.patterns, |it| &it.input);
    if inputs.is_empty() {
        return None;
    }
    let title = format!(
        "Weakest (m, k): m of any k messages may be lost, in a row; least of {}",
        sparse(margins)
    );
    let weakest = table(margins, &inputs, |law| {
        let weakest = law.patterns.iter().map(|it| it.weakest());
        let cells = weakest.map(|it| known(it.map(|[m, k]| format!("({m}, {k})"))));
        cells.collect()
    });
    let pattern = |[m, k]: &[u64; 2]| format!("{m} of {k}");
    let each = table(margins, &inputs, |law| {
        let patterns = law.patterns.iter();
        let patterns = patterns.map(|it| it.most.iter().map(pattern).collect::<Vec<_>>());
        patterns.map(|most| most.join(", ")).collect()
    });
    let summary = "For each k the largest m up to which the flights survived".into();
    let blocks = vec![weakest, Block::Details(summary, vec![each])];
    Some(Section::new("patterns", title, blocks))
}

/// What was found against the order of things; says also that nothing was.
fn exceptions(margins: &Margins) -> Option<Section> {
    const SHOWN: usize = 6;
    let mut all = Vec::new();
    for law in &margins.laws {
        let outages = law.outages.iter();
        let exceptions = outages.flat_map(|of| of.exceptions.iter().map(move |it| (&of.of, it)));
        for (of, it) in exceptions {
            let what = match it.survived {
                true => "survived, where a shorter one was not",
                false => "lost, where a longer one was survived",
            };
            let (name, ticks) = (margins.name_of(&law.laws), count(it.ticks, "tick"));
            let phase_s = it.phase_s;
            all.push(format!(
                "{name}: {of} out for {ticks} at {phase_s:.3} s: {what}"
            ));
        }
    }
    if all.is_empty() {
        let none =
            "No outage that was tried beyond a margin was survived, and none within it was lost";
        return Some(Section::new("exceptions", none, Vec::new()));
    }
    let more = all.len().saturating_sub(SHOWN);
    all.truncate(SHOWN);
    if more > 0 {
        all.push(format!("and {more} more, in --format json"));
    }
    let title = "Against the order of things (a margin is the longest outage up to which none that was tried was lost)";
    Some(Section::new("exceptions", title, vec![Block::Items(all)]))
}
