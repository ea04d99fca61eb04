//! Robustness margins: the limits of each combination of laws as tables, then what its flights did as curves.

use crate::comparison::{lacking_preset, thousandths};
use crate::document::{self, Block, Cell, Document, Figure, Section, known};
use crate::plot::{Axis, Chart, LAWS, Layer};
use crate::scale::Scale;
use analysis::margin::{
    CALM, Kind, LIMITS, LawMargins, LoopMargin, Margins, Point, RECOVERS, SURVIVES, Search,
    UNNOTICED,
};
use analysis::phrase::{count, list, name_of};

/// Errors below are drawn as this [m].
const ERROR_MIN_M: f64 = 1e-4;

pub fn document(margins: &Margins) -> Document {
    let lead = [conditions(margins), phases(margins)].into_iter();
    let lead = lead.chain(criteria(margins)).map(Block::Paragraph);
    // Tables of earlier versions do not say.
    let flown = margins.laws.iter().filter(|it| !it.preset.is_empty());
    let lead = lead.chain([lacking_preset(
        &margins.preset,
        flown.map(|it| (margins.name_of(&it.laws), &*it.preset)),
    )]);
    let curves = [
        ("outage", "Outages", Kind::Outage, "length [ticks]"),
        ("lag", "Steady lag", Kind::Lag, "lag [ticks]"),
        ("delay", "Steady delay", Kind::Delay, "delay [ticks]"),
        ("loss", "Random losses", Kind::Loss, "messages lost [%]"),
    ];
    let curves = curves.map(|(id, title, kind, label)| curves_of(margins, id, title, kind, label));
    let sections = [limits(margins), predicted(margins)];
    let sections = sections
        .into_iter()
        .chain([unfaulted(margins), exceptions(margins)]);
    Document {
        title: format!("margins, {}", conditions(margins)),
        heading: "Robustness of the loop".into(),
        build: margins.build.to_string(),
        lead: lead.collect(),
        sections: sections.chain(curves).flatten().collect(),
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
    let phases = phases_of(margins, 1);
    let span_s = margins.span_s;
    format!("{phases} over {span_s:.3} s from {first_s:.3} s on{of}")
}

fn criteria(margins: &Margins) -> [String; 2] {
    let it = &margins.bounds;
    let meaning = format!(
        "unnoticed: the errors of position and yaw stay below {} m and {} rad; recovers, survives: they are below {} m and \
         {} rad from {} s or {} s on, after the end of an outage or the beginning of a steady fault; always: envelope kept; oscillates: under a lag, delay or \
         gain, the change of the body rate per tick is more than {} rad/s above that without a fault (root of the \
         difference of their mean squares)",
        it.unnoticed_below_m,
        it.unnoticed_yaw_below_rad,
        it.recovered_below_m,
        it.recovered_yaw_below_rad,
        it.recovery_max_s,
        it.survival_max_s,
        it.rate_step_increase_rad_s,
    );
    let cells = format!(
        "each cell: {}, then why the next flight fails: ground, tilt, position, diverged (lost); error, yaw (flies on, above {} \
         m or {} rad); and from where on it oscillates, if it does before. N+: more was not tried. -: not qualified, the error without a fault is too large",
        LIMITS[..CALM].join("/"),
        it.recovered_below_m,
        it.recovered_yaw_below_rad
    );
    [meaning, cells]
}

fn table(
    margins: &Margins,
    columns: &[impl ToString],
    cells: impl Fn(&LawMargins) -> Vec<String>,
) -> Block {
    let rows = margins.laws.iter().map(|law| {
        let name = [margins.name_of(&law.laws)].into_iter();
        name.chain(cells(law)).map(Cell::from).collect()
    });
    let columns = columns.iter().map(ToString::to_string);
    document::table(["laws".to_owned()].into_iter().chain(columns), rows)
}

fn searches(margins: &Margins, kind: Kind) -> Vec<&String> {
    let first = margins.laws.first().into_iter();
    let all = first.flat_map(|law| &law.searches);
    all.filter(|it| it.kind == kind).map(|it| &it.of).collect()
}

fn phases_of(margins: &Margins, sparse: usize) -> String {
    count(margins.phases_s.len().div_ceil(sparse) as u64, "phase")
}

fn is_input(of: &str) -> bool {
    of.contains('.')
}

fn number(search: &Search, at: u64) -> String {
    let more = if at >= search.most { "+" } else { "" };
    match search.kind {
        Kind::Gain => format!("{:.1}{more}", 1.0 + at as f64 / 10.0),
        _ => format!("{at}{more}"),
    }
}

/// A strength that a limit allows.
fn strength(search: &Search, limit: usize) -> String {
    known(search.limits[limit].map(|at| number(search, at)))
}

/// Why the first flight beyond the last limit fails.
fn ending(search: &Search) -> String {
    let beyond = search.limits[SURVIVES].and_then(|it| search.beyond(it));
    let cause = beyond.and_then(|point| point.cause);
    cause.map_or_else(String::new, |cause| format!(" {}", name_of(&cause)))
}

fn cell(search: &Search) -> String {
    let limits: Vec<String> = (0..CALM).map(|it| strength(search, it)).collect();
    let repeated = search
        .repeated
        .map(|[survived, all]| format!(" ({survived} of {all})"));
    let repeated = repeated.unwrap_or_default();
    let oscillates = oscillates_from(search).map(|it| format!(", oscillates from {it}"));
    limits.join("/") + &ending(search) + &oscillates.unwrap_or_default() + &repeated
}

/// The least strength that was flown in a limit cycle, if such flights survive.
fn oscillates_from(search: &Search) -> Option<String> {
    let [calm, survived] = [CALM, SURVIVES].map(|it| search.limits[it]);
    let beyond = search.beyond(calm.filter(|it| Some(*it) < survived)?)?;
    Some(number(search, beyond.at))
}

fn limits(margins: &Margins) -> Option<Section> {
    let ticks = format!("[ticks of {} ms]", margins.period_s * 1e3);
    let all = phases_of(margins, 1);
    let tables = [
        (
            Kind::Outage,
            false,
            format!("Longest outage {ticks}; least of {all}"),
        ),
        (
            Kind::Outage,
            true,
            format!("Longest loss of all messages {ticks}; least of {all}"),
        ),
        (
            Kind::Lag,
            true,
            format!("Longest steady lag {ticks}: in time, but so old (dead time); least of {all}"),
        ),
        (
            Kind::Delay,
            true,
            format!(
                "Longest steady delay {ticks}: late, and known as stale; least of {all}. Without inputs of the state: \
                 stages ignore a late one, so that 1 tick loses the flight, which is no margin of the loop"
            ),
        ),
        (
            Kind::Loss,
            true,
            format!(
                "Largest share of random losses [%]; least of {all} (how many flights with other seeds survive the last \
                 share)"
            ),
        ),
    ];
    let mut blocks = Vec::new();
    for (kind, of_inputs, title) in tables {
        let mut columns = searches(margins, kind);
        columns.retain(|of| is_input(of) == of_inputs);
        if !columns.is_empty() {
            let cells = |law: &LawMargins| {
                let searches = columns.iter().filter_map(|of| law.search(kind, of));
                searches.map(cell).collect()
            };
            blocks.extend([Block::Heading(title), table(margins, &columns, cells)]);
        }
    }
    blocks.extend(patterns(margins));
    (!blocks.is_empty()).then(|| Section::new("limits", "Limits", blocks))
}

/// For each length of a pattern, how many messages in a row may be lost of every so many.
fn patterns(margins: &Margins) -> Vec<Block> {
    let inputs = searches(margins, Kind::Lag);
    let pattern = |search: &Search| match search.kind {
        Kind::Pattern(length) => Some(length),
        _ => None,
    };
    let all = margins.laws.iter().flat_map(|law| &law.searches);
    let mut lengths: Vec<u64> = all.filter_map(pattern).collect();
    lengths.sort_unstable();
    lengths.dedup();
    if lengths.is_empty() {
        return Vec::new();
    }
    let cells = |law: &LawMargins| {
        let most = |of: &&String| {
            let searches = lengths
                .iter()
                .filter_map(|it| law.search(Kind::Pattern(*it), of));
            let most = searches.map(|it| known(it.limits[SURVIVES]));
            most.collect::<Vec<_>>().join(" ")
        };
        inputs.iter().map(most).collect()
    };
    let title = format!(
        "Patterns: how many messages in a row of every {} may be lost (survives); least of {}",
        list(&lengths),
        phases_of(margins, margins.sparse)
    );
    vec![Block::Heading(title), table(margins, &inputs, cells)]
}

fn predicted(margins: &Margins) -> Option<Section> {
    let gains = searches(margins, Kind::Gain);
    let of = gains.first()?;
    let columns = [
        "predicted delay [ticks]",
        "measured",
        "predicted gain",
        "measured",
        "crossover [rad/s]",
        "phase margin [deg]",
        "axis",
    ];
    let table = table(margins, &columns, |law| {
        let measured = |kind| {
            let search = law.search(kind, of)?;
            Some(match oscillates_from(search) {
                Some(_) => strength(search, CALM) + " oscillates",
                None => strength(search, SURVIVES) + &ending(search),
            })
        };
        let predicted = &law.predicted;
        let (delay, gain) = (
            predicted.least(|it| it.delay_ticks),
            predicted.least(|it| it.gain),
        );
        let margin = |least: Option<(f64, &LoopMargin)>| match predicted.unsettled.as_slice() {
            [] => known(least.map(|(margin, _)| format!("{margin:.2}"))),
            [axis] => format!("none: {axis} does not settle"),
            axes => format!("none: {} do not settle", axes.join(", ")),
        };
        let of_delay = |of: fn(&LoopMargin) -> Option<f64>| {
            known(delay.and_then(|(_, it)| Some(format!("{:.1}", of(it)?))))
        };
        vec![
            margin(delay),
            known(measured(Kind::Lag)),
            margin(gain),
            known(measured(Kind::Gain)),
            of_delay(|it| it.crossover_rad_s),
            of_delay(|it| it.phase_margin_deg),
            known(delay.map(|(_, it)| &it.axis)),
        ]
    });
    let title = format!(
        "Stability margins of the loop through {of}: predicted at hover; measured as the steady lag and the gain that are \
         survived without a limit cycle (inertia and rotational drag divided by it); least of {}",
        phases_of(margins, 1)
    );
    Some(Section::new("predicted", title, vec![table]))
}

fn unfaulted(margins: &Margins) -> Option<Section> {
    let columns = [
        "error [mm]",
        "yaw error [mrad]",
        "rate change per tick [mrad/s]",
        "qualified for",
        "flights",
    ];
    let table = table(margins, &columns, |law| {
        let it = &law.unfaulted;
        let qualified = LIMITS.into_iter().zip(law.qualified);
        let qualified: Vec<&str> = qualified.filter(|it| it.1).map(|it| it.0).collect();
        let cause = it
            .cause
            .map(|cause| format!("no limit: {}", name_of(&cause)));
        let qualified = match qualified.is_empty() {
            true => cause.unwrap_or_else(|| "no limit".into()),
            false => qualified.join(", "),
        };
        let rate_step = format!("{:.2}", 1e3 * it.rate_step_increase_rad_s);
        vec![
            known(it.peak_m.map(thousandths)),
            known(it.peak_yaw_rad.map(thousandths)),
            rate_step,
            qualified,
            law.flights.to_string(),
        ]
    });
    Some(Section::new("unfaulted", "Without a fault", vec![table]))
}

/// What curves show of a point, its label, and the limits that are levels of it.
type Quantity = (
    &'static str,
    fn(&Point) -> Option<f64>,
    Vec<(f64, &'static str)>,
);

/// Curves of the worst flight of each strength; outages of inputs are folded away below those of stages.
fn curves_of(
    margins: &Margins,
    id: &'static str,
    title: &str,
    kind: Kind,
    label: &str,
) -> Option<Section> {
    let bounds = &margins.bounds;
    let peak: Quantity = (
        "peak error [m]",
        |it| it.peak_m.map(|peak_m| peak_m.max(ERROR_MIN_M)),
        vec![(bounds.unnoticed_below_m, LIMITS[UNNOTICED])],
    );
    let recovery: Quantity = (
        "recovery time [s]",
        |it| it.recovery_s,
        vec![
            (bounds.recovery_max_s, LIMITS[RECOVERS]),
            (bounds.survival_max_s, LIMITS[SURVIVES]),
        ],
    );
    let mut quantities = vec![peak];
    // A steady fault is not recovered from.
    quantities.extend((kind == Kind::Outage).then_some(recovery));
    let figures = |of: &[&String]| -> Vec<Figure> {
        let figure = |of: &String, it: &Quantity| {
            let chart = chart(margins, (kind, of), label, it);
            Figure::new(format!("curve-{id}-{of}"), of, Vec::new(), chart)
        };
        let each = |of: &&String| {
            quantities
                .iter()
                .map(|it| figure(of, it))
                .collect::<Vec<_>>()
        };
        of.iter().flat_map(each).collect()
    };
    let all = searches(margins, kind);
    let (mut folded, mut shown): (Vec<&String>, Vec<&String>) =
        all.iter().partition(|of| is_input(of));
    if shown.is_empty() {
        std::mem::swap(&mut shown, &mut folded);
    }
    if shown.is_empty() {
        return None;
    }
    let names = margins.laws.iter().map(|law| margins.name_of(&law.laws));
    let note = "The worst flight of all phases. A line ends with a dot at the last strength that the law survives. Earlier \
                lines are wider, so that equal ones show.";
    let mut blocks = vec![
        Block::Legend(LAWS.into_iter().zip(names).collect()),
        Block::Note(note.into()),
        Block::WideFigures(figures(&shown)),
    ];
    if !folded.is_empty() {
        let inputs = Block::WideFigures(figures(&folded));
        let summary = "Inputs that lose all messages".into();
        blocks.push(Block::Details(summary, vec![inputs]));
    }
    Some(Section::new(id, title, blocks))
}

/// A line for each combination, up to the greatest strength that it survives.
fn chart(
    margins: &Margins,
    (kind, of): (Kind, &str),
    label: &str,
    (value_label, value, levels): &Quantity,
) -> Chart {
    let mut layers = Vec::new();
    let mut all: Vec<(f64, f64)> = Vec::new();
    for (law, class) in margins.laws.iter().zip(LAWS) {
        let search = law.search(kind, of);
        let Some((search, limit)) = search.and_then(|it| Some((it, it.limits[SURVIVES]?))) else {
            continue;
        };
        let points = search.points.iter().take_while(|point| point.at <= limit);
        let points = points.filter_map(|point| Some((point.at as f64, value(point)?)));
        let line: Vec<(f64, f64)> = points.collect();
        let word = format!("{} survives {limit}", margins.name_of(&law.laws));
        let dot = line.last().map(|end| (*end, word));
        all.extend(&line);
        layers.extend([
            Layer::Line(class, line),
            Layer::Dots(class, dot.into_iter().collect()),
        ]);
    }
    let (strengths, values): (Vec<f64>, Vec<f64>) = all.into_iter().unzip();
    let scale = |values: Vec<f64>, is_log: bool| match is_log {
        true => Scale::log(values.into_iter()),
        false => Scale::time(0.0, values.into_iter().fold(1.0, f64::max)),
    };
    let x = scale(strengths, kind == Kind::Outage);
    let y = scale(values, value_label.ends_with("[m]"));
    let shown = levels
        .iter()
        .filter(|(level, _)| (y.low..=y.high).contains(level));
    layers.extend(shown.map(|(level, name)| Layer::Level("floor", *level, name)));
    let title = format!("{value_label} over {label} of {of}");
    Chart::new(
        title,
        Axis::new(x, label),
        Axis::new(y, *value_label),
        layers,
    )
}

/// Outages that were survived although a shorter one was not; says also that there were none.
fn exceptions(margins: &Margins) -> Option<Section> {
    const SHOWN: usize = 6;
    let mut all = Vec::new();
    for law in &margins.laws {
        let outages = law.searches.iter().filter(|it| it.kind == Kind::Outage);
        for search in outages {
            let Some(limit) = search.limits[SURVIVES] else {
                continue;
            };
            let survived = |point: &&Point| point.at > limit && point.cause.is_none();
            all.extend(search.points.iter().filter(survived).map(|point| {
                let (name, ticks) = (margins.name_of(&law.laws), count(point.at, "tick"));
                format!(
                    "{name}: {} out for {ticks} is survived, a shorter outage is not",
                    search.of
                )
            }));
        }
    }
    if all.is_empty() {
        let none = "No exceptions: no outage that was tried beyond a limit is survived";
        return Some(Section::new("exceptions", none, Vec::new()));
    }
    let more = all.len().saturating_sub(SHOWN);
    all.truncate(SHOWN);
    if more > 0 {
        all.push(format!("and {more} more, in --format json"));
    }
    let title =
        "Exceptions (a limit is the longest outage up to which none that was tried was lost)";
    Some(Section::new("exceptions", title, vec![Block::Items(all)]))
}
