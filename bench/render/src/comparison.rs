//! A comparison of control laws on one flight.

use crate::document::{self, Block, Cell, Document, Figure, Section};
use crate::figures::{self, ANGLES, AXES, SYMBOLS, UNITS};
use crate::plot::{Axis, Chart, LAWS, Layer, braided, through};
use crate::scale::Scale;
use analysis::comparison::{
    Comparison, ErrorFigures, Fault, Figures, Flight, Outcome, POWER, TRUE_ERROR,
};
use analysis::recovery::{STAYING_S, STAYING_SHARE, is_too_short};
use analysis::schema::{AGITATION, AngleErrors};
use analysis::traces::{self, Group, Span};

/// Errors below are drawn as this [m]: that of a flight at rest has no logarithm.
const ERROR_MIN_M: f64 = 1e-5;

/// The laws, each with the preset that it flew, that do not have a preset.
pub fn lacking_preset<'a>(preset: &str, flown: impl Iterator<Item = (String, &'a str)>) -> Block {
    let lacks = flown.filter(|(_, own)| *own != preset);
    let lacks =
        lacks.map(|(name, _)| format!("{name} has no preset `{preset}`: flown with its defaults"));
    Block::Items(lacks.collect())
}

pub fn document(comparison: &Comparison) -> Document {
    let flight = &comparison.flight;
    let combinations = comparison.outcomes.len();
    let fault = |fault: &Fault| format!("{:>8.3} s  {}", fault.time_s, fault.what);
    let mut lead = vec![Block::Paragraph(conditions(flight))];
    if !flight.faults.is_empty() {
        lead.push(Block::Items(flight.faults.iter().map(fault).collect()));
    }
    let flown = comparison.outcomes.iter();
    let flown = flown.map(|it| (comparison.name_of(&it.laws), &*it.preset));
    lead.push(lacking_preset(&flight.preset, flown));
    let mut sections = vec![over_time(comparison)];
    sections.extend(motion(comparison));
    sections.extend(position_errors(comparison));
    sections.push(attitude_errors(comparison));
    sections.extend(recovery(comparison));
    let columns = ["power [hover]", AGITATION, "saturated [%]", "outputs"];
    let effort = table(comparison, columns, |outcome| {
        let effort = &outcome.figures.effort;
        vec![
            format!("{:.4}", effort.power),
            significant(effort.agitation_rad_s),
            format!("{:.2}", effort.saturated_percent),
            outcome.outputs.clone(),
        ]
    });
    sections.push(Section::new("effort", "Effort", vec![effort]));
    sections.extend(endings(comparison));
    Document {
        title: format!(
            "{combinations} combinations of laws, {}",
            conditions(flight)
        ),
        heading: format!("{combinations} combinations of laws, one flight"),
        build: comparison.build.to_string(),
        lead,
        sections,
        footer: ". The hash of each flight is the one that `ironbird simulate` prints.".into(),
        ..Document::default()
    }
}

pub(crate) fn conditions(flight: &Flight) -> String {
    let length_s = flight.time_s(flight.last_tick);
    let (airframe, seed) = (&flight.airframe, flight.seed);
    let flown = crate::flight::conditions(&flight.trajectory, &flight.preset, airframe);
    format!("{flown}, {length_s} s, seed {seed}")
}

fn table(
    comparison: &Comparison,
    columns: impl IntoIterator<Item = impl ToString>,
    cells: impl Fn(&Outcome) -> Vec<String>,
) -> Block {
    let is_any_lost = comparison.outcomes.iter().any(|it| it.lost_s.is_some());
    let lost = |it: &Outcome| {
        it.lost_s
            .map_or("-".into(), |time_s| format!("{time_s:.3} s"))
    };
    let rows = comparison.outcomes.iter().map(|it| {
        let lost = is_any_lost.then(|| lost(it));
        let first = [comparison.name_of(&it.laws)].into_iter().chain(lost);
        first.chain(cells(it)).map(Cell::from).collect()
    });
    let columns = columns.into_iter().map(|column| column.to_string());
    let lost = is_any_lost.then(|| "lost at".to_owned());
    let first = ["laws".to_owned()].into_iter().chain(lost);
    document::table(first.chain(columns), rows)
}

/// The true position errors, of a flight with faults before and after them.
fn position_errors(comparison: &Comparison) -> Vec<Section> {
    type Errors = fn(&Figures) -> Option<ErrorFigures>;
    let flight = &comparison.flight;
    let parts: Vec<(&'static str, String, Errors)> =
        match (flight.faults.first(), flight.settled_tick()) {
            (Some(Fault { time_s, .. }), Some(settled)) => {
                let before = format!("before {time_s:.3} s ");
                let from = format!("from {time_s:.3} s on ");
                let after = format!("from {:.3} s on ", flight.time_s(settled));
                vec![
                    ("error-before", before, |it| it.error_before),
                    ("error-from-fault", from, |it| it.error_from_fault),
                    ("error-after", after, |it| it.error_after),
                ]
            }
            _ => vec![("error", String::new(), |it| Some(it.error))],
        };
    let section = |(id, when, of): (&'static str, String, Errors)| {
        let cells = |outcome: &Outcome| match of(&outcome.figures) {
            Some(it) => [it.rms_m, it.p99_m, it.worst_m].map(thousandths).into(),
            None => vec!["-".to_owned(); 3],
        };
        let table = table(comparison, ["rms", "p99", "worst"], cells);
        Section::new(id, format!("True position error {when}[mm]"), vec![table])
    };
    let outcomes = &comparison.outcomes;
    let has_any =
        |(.., of): &(&str, String, Errors)| outcomes.iter().any(|it| of(&it.figures).is_some());
    parts.into_iter().filter(has_any).map(section).collect()
}

fn attitude_errors(comparison: &Comparison) -> Section {
    let columns = ["yaw rms", "yaw largest", "tilt rms", "tilt largest"];
    let table = table(comparison, columns, |outcome| {
        let of = |error: &Option<AngleErrors>| {
            let numbers = |it: &AngleErrors| [it.rms_rad, it.max_rad].map(thousandths);
            error.as_ref().map_or(["-".into(), "-".into()], numbers)
        };
        let figures = &outcome.figures;
        [of(&figures.yaw_error), of(&figures.tilt_error)].concat()
    });
    Section::new("attitude", "True attitude error [mrad]", vec![table])
}

/// When the flights had recovered from each fault.
fn recovery(comparison: &Comparison) -> Option<Section> {
    let flight = &comparison.flight;
    let faults = flight.faults.iter();
    let columns = faults.map(|fault| format!("fault at {:.3} s", fault.time_s));
    let title = format!(
        "Recovery: time from each fault until the true errors stay below {} m and {} rad of yaw: for at least {STAYING_S} s, \
         for {:.0} % of the time after the fault, and for longer than in any stretch before",
        flight.bound_m,
        flight.bound_yaw_rad,
        100.0 * STAYING_SHARE
    );
    let table = table(comparison, columns, |it| {
        recoveries_of(flight, it).collect()
    });
    (!flight.faults.is_empty()).then(|| Section::new("recovery", title, vec![table]))
}

/// Why flights were lost, and what laws answered that could not be used.
fn endings(comparison: &Comparison) -> Vec<Section> {
    let named =
        |outcome: &Outcome, what: &str| format!("{}: {what}", comparison.name_of(&outcome.laws));
    let outcomes = &comparison.outcomes;
    let mut lost = Vec::new();
    let mut unusable = Vec::new();
    for it in outcomes {
        lost.extend(ending(it).map(|why| named(it, &why)));
        unusable.extend(it.unusable.iter().map(|what| named(it, what)));
    }
    let mut sections = vec![if lost.is_empty() {
        let all = format!("All {} flew to the end", outcomes.len());
        Section::new("lost", all, Vec::new())
    } else {
        Section::new("lost", "Lost", vec![Block::Items(lost)])
    }];
    if !unusable.is_empty() {
        let title = "Outputs that could not be used";
        let items = vec![Block::Items(unusable)];
        sections.push(Section::new("unusable", title, items));
    }
    sections
}

fn over_time(comparison: &Comparison) -> Section {
    let names = comparison.outcomes.iter();
    let names = names.map(|outcome| comparison.name_of(&outcome.laws));
    let keys: Vec<(&'static str, String)> = LAWS.into_iter().zip(names).collect();
    let note = "Each line is drawn through the smallest and the largest value of its stretches; it ends where the flight \
                ended or was lost. Lines that coincide take turns on top. The error is by the truth, not by the sensors; power is the sum of the cubed rotor speeds, as a \
                multiple of that in hover.";
    let (lines, values) = lines(comparison, errors_and_power, POWER, 0.0);
    let scale = Scale::linear(values.into_iter(), 0.01);
    let power = over(comparison, "rotor power [hover]", scale, lines);
    let error = error_chart(comparison);
    let figures = vec![
        Figure::new("error", "True position error", keys.clone(), error),
        Figure::new("power", "Rotor power", keys, power),
    ];
    let blocks = vec![
        Block::Legend(vec![("mark swap", "fault".into())]),
        Block::WideFigures(figures),
        Block::Note(note.into()),
    ];
    Section::new("time", "Over time", blocks)
}

fn error_chart(comparison: &Comparison) -> Chart {
    let bound_m = comparison.flight.bound_m;
    let (mut lines, values) = lines(comparison, errors_and_power, TRUE_ERROR, ERROR_MIN_M);
    lines.push(Layer::Level("deadline", bound_m, "recovered"));
    let scale = Scale::log(values.into_iter().chain([bound_m.max(ERROR_MIN_M)]));
    over(comparison, "true position error [m]", scale, lines)
}

fn errors_and_power(outcome: &Outcome) -> Option<&Group> {
    outcome.figures.trace.as_ref()
}

fn motion_of(outcome: &Outcome) -> Option<&Group> {
    outcome.motion.as_ref().map(|it| &it.flight)
}

/// Path, position, attitude, rotor commands and estimates, where they were kept.
fn motion(comparison: &Comparison) -> Option<Section> {
    let outcomes = &comparison.outcomes;
    let first = outcomes.iter().find_map(|it| it.motion.as_ref())?;
    let names = outcomes.iter().map(|it| comparison.name_of(&it.laws));
    let reference = ("reference", "reference, or true value".to_owned());
    let keys = LAWS.into_iter().zip(names).chain([reference]);
    let reference = first.path.reference_w_m.as_slice();
    let ways = outcomes.iter().zip(LAWS);
    let ways =
        ways.filter_map(|(it, law)| Some((law, it.motion.as_ref()?.path.position_w_m.as_slice())));
    let ways: Vec<_> = [("reference", reference)].into_iter().chain(ways).collect();
    let path = |plane: [usize; 2], title: &str| {
        let id = format!("way-{}{}", AXES[plane[0]], AXES[plane[1]]);
        Figure::new(id, title, Vec::new(), figures::plane(plane, &ways))
    };
    let mut shown = vec![
        path([0, 1], "Path seen from above"),
        path([0, 2], "Path seen along y"),
    ];
    let position = (0..3).map(|i| {
        let reference = Some(traces::POSITION_REFERENCE[i]);
        let label = format!("{} [m]", AXES[i]);
        (label, traces::POSITION[i], reference, 0.01)
    });
    let attitude = (0..3).map(|i| {
        let label = format!("{} [rad]", ANGLES[i]);
        (label, traces::ATTITUDE[i], None, 0.01)
    });
    let rotors = (0..4).map(|i| {
        let label = format!("command of rotor {} [rad/s]", i + 1);
        (label, traces::ROTORS[i], None, 1.0)
    });
    let estimates = (0..3).map(|i| {
        let label = format!("estimate of {} [{}]", SYMBOLS[i], UNITS[i]);
        (label, traces::ESTIMATE[i], Some(traces::ACTUAL[i]), 0.0)
    });
    for (label, channel, reference, least) in
        position.chain(attitude).chain(rotors).chain(estimates)
    {
        let (mut layers, mut values) = lines(comparison, motion_of, channel, f64::NEG_INFINITY);
        let groups = outcomes.iter().filter_map(motion_of);
        let longest = groups
            .filter(|it| it.has(channel))
            .max_by_key(|it| it.tick.last());
        let Some(longest) = longest else {
            continue;
        };
        let spans = reference.into_iter().flat_map(|it| longest.spans(it));
        let points = through(spans, |tick| [comparison.flight.time_s(tick); 2]);
        values.extend(points.iter().map(|point| point.1));
        layers.insert(0, Layer::Line("reference", points));
        let scale = Scale::linear(values.into_iter(), least);
        let chart = over(comparison, &label, scale, layers);
        let id = format!("motion-{channel}");
        shown.push(Figure::new(id, label, Vec::new(), chart));
    }
    let blocks = vec![Block::Legend(keys.collect()), Block::Figures(shown)];
    Some(Section::new(
        "motion",
        "Path, motion, commands and estimates",
        blocks,
    ))
}

/// A line for each combination, and all values on them; what is below `least` is drawn there.
fn lines(
    comparison: &Comparison,
    group: fn(&Outcome) -> Option<&Group>,
    channel: &str,
    least: f64,
) -> (Vec<Layer>, Vec<f64>) {
    let flight = &comparison.flight;
    let mut values = Vec::new();
    let line = |(outcome, class): (&Outcome, &'static str)| {
        let trace = group(outcome).into_iter();
        let last = trace
            .clone()
            .map(|trace| trace.every_ticks)
            .sum::<u64>()
            .saturating_sub(1);
        let ends_s = |tick| [flight.time_s(tick), flight.time_s(tick + last)];
        let spans = trace
            .flat_map(|trace| trace.spans(channel))
            .map(|span| Span {
                min: span.min.max(least),
                max: span.max.max(least),
                ..span
            });
        let points = through(spans, ends_s);
        values.extend(points.iter().map(|point| point.1));
        (class, points)
    };
    let lines = comparison.outcomes.iter().zip(LAWS).map(line);
    // A law without estimates has no line among them.
    let lines = lines.filter(|(_, points)| !points.is_empty()).collect();
    (braided(lines, 0.0, end_s(comparison)), values)
}

/// End of the last flight, or of the last one that was not lost [s].
fn end_s(comparison: &Comparison) -> f64 {
    let flight = &comparison.flight;
    let ends = comparison.outcomes.iter().map(|it| {
        let last = it.ticks.saturating_sub(1);
        it.lost_s.unwrap_or(flight.time_s(last))
    });
    ends.fold(0.0, f64::max)
}

/// A chart up to the end of the last flight, with its faults below what it shows.
fn over(comparison: &Comparison, label: &str, scale: Scale, layers: Vec<Layer>) -> Chart {
    let flight = &comparison.flight;
    let words = |it: &Fault| {
        let word = format!("fault at {:.3} s: {}", it.time_s, it.what);
        (it.time_s, word)
    };
    let faults = Layer::verticals("swap", flight.faults.iter().map(words));
    let layers = [faults].into_iter().chain(layers).collect();
    let x = Scale::time(0.0, end_s(comparison));
    let (x, y) = (Axis::new(x, "time [s]"), Axis::new(scale, label));
    Chart::new(format!("{label} over time"), x, y, layers)
}

/// Per fault, when a flight had recovered from it, in words.
fn recoveries_of(flight: &Flight, outcome: &Outcome) -> impl Iterator<Item = String> {
    let ends = flight.faults.iter().skip(1).map(|next| next.tick);
    let ends = ends.chain([flight.last_tick + 1]);
    let faults = flight.faults.iter().zip(ends);
    let each = outcome.figures.recovery_s.iter().zip(faults);
    each.map(|(time_s, (fault, end))| match time_s {
        Some(0.0) => "never above".into(),
        Some(time_s) => format!("after {time_s:.3} s"),
        None if is_too_short(end.saturating_sub(fault.tick), flight.period_s) => {
            "too short to tell".into()
        }
        None if end > flight.last_tick => "not recovered within the flight".into(),
        None => "not recovered before the next".into(),
    })
}

/// How a flight was lost; none where it was not.
fn ending(outcome: &Outcome) -> Option<String> {
    let why = outcome.lost.as_ref()?;
    Some(match outcome.ended_early_s {
        Some(time_s) => format!("ended at {time_s:.3} s: {why}"),
        None => why.clone(),
    })
}

/// A length in millimetres or an angle in milliradians, with three digits that count.
pub fn thousandths(value: f64) -> String {
    significant(1e3 * value)
}

/// A number with about three digits that count, and without an exponent.
pub(crate) fn significant(value: f64) -> String {
    let digits = match value.abs() {
        100.0.. => 0,
        10.0.. => 1,
        1.0.. => 2,
        _ => 3,
    };
    format!("{value:.digits$}")
}
