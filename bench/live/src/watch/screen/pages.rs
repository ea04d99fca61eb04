//! The six pages of the dashboard. On a narrow terminal, a row ends before the first cell that has no room.

use std::cell::Cell;

use analysis::schema::{NOT_FRESH, SignalSection};
use analysis::sections::role_section;
use analysis::series::{Series, Statistics};
use analysis::theorem::{Theorem, no_theorem};
use controller::laws::adaptive;
use errors::errno_text;
use hdrhistogram::Histogram;
use messages::blackboards::Status;
use messages::content::Mode;
use messages::monitor::{Cause, Monitor};
use messages::realtime::RealtimeStep;
use messages::role::{Replica, Role};
use messages::telemetry::LAW_ROLES;
use process::rt::remedy;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::canvas::{Canvas, Line as Stroke};
use render::document::{known, us};

use super::region::{BAD, FAINT, GOOD, HEADING, PLAIN, Region, fitting, good_or_bad, wrapped};
use crate::parameter_text::{Row, bound, number, rows};
use crate::watch::dashboard_model::{Model, POINT_S, ParameterPage, Tab, WatchedFlight};

/// Events that are shown.
const EVENTS: usize = 5;

pub(super) fn draw(model: &Model, flight: &WatchedFlight, region: &mut Region<'_, '_>) {
    match model.tab {
        Tab::Flight => flight_page(flight, &model.scrolled, region),
        Tab::Latency => latency_page(flight, model.series, region),
        Tab::Theorem => theorem_page(flight, region),
        Tab::Plant => plant_page(flight, &model.parameters, region),
        Tab::RealTime => real_time_page(flight, &model.scrolled, region),
        Tab::Laws => laws_page(flight, &model.scrolled, region),
    }
}

/// Position, attitude, horizon, channel, processes, faults and events; the position error over time, if there is room.
fn flight_page(flight: &WatchedFlight, scrolled: &Cell<usize>, region: &mut Region<'_, '_>) {
    const NUMBERS: u16 = 50;
    const HORIZON: (u16, u16) = (26, 12);
    let page = region.area;
    let mut lines = flight_numbers(flight, page.width);
    lines.extend(situation(flight, page.width));
    region.put_scrolled(lines, scrolled);
    let (width, height) = HORIZON;
    if scrolled.get() == 0 && page.width >= NUMBERS + width && page.height >= height {
        let area = Rect {
            x: page.x + NUMBERS + (page.width - NUMBERS - width).min(8),
            y: page.y,
            width,
            height,
        };
        region.frame.render_widget(horizon(flight), area);
    }
    if region.area.height >= 4 {
        region.split(1);
        let points = flight.position_error.newest(usize::from(region.area.width));
        let most = points.iter().copied().fold(0.0, f64::max);
        let span_s = f64::from(region.area.width) * POINT_S;
        let title = format!("position error, last {span_s:.0} s; full height {most:.4} m");
        region.put(vec![Line::styled(title, HEADING)]);
        region.put_bars(&points, [0.0, most]);
    }
}

fn flight_numbers<'a>(flight: &WatchedFlight, width: u16) -> Vec<Line<'a>> {
    let row = |(name, values, digits): (&str, &[f64], usize)| {
        let width = 24 / values.len();
        let cell = |value: &f64| format!("{value:>width$.digits$}");
        let cells: String = values.iter().map(cell).collect();
        Line::from(format!("{name:<14}{cells}"))
    };
    let heading = |[a, b, c]: [&str; 3]| {
        let text = format!("{:<14}{a:>8}{b:>8}{c:>8}", "");
        Line::styled(text, HEADING)
    };
    let state = flight.state.unwrap_or_default();
    let setpoint = flight.setpoint.unwrap_or_default();
    let measured = &state.measured;
    let (p, r) = (state.truth.position_w_m, setpoint.reference.position_w_m);
    let off = [0, 1, 2].map(|i| p[i] - r[i]);
    let thrust_n = flight.rotor_speeds.unwrap_or_default().thrust_n;
    let total = flight.statistics.flight();
    let (now_m, rms_m) = (total.position_error_final_m, total.position_error_rms_m);
    let max_m = total.position_error_max_m;
    let error = [
        format!("{:<14}{now_m:>8.4}", "|error| [m]"),
        format!("  rms {rms_m:.4}"),
        format!("  max {max_m:.4}"),
    ];
    vec![
        heading(["x", "y", "z"]),
        row(("position [m]", &p, 3)),
        row(("reference [m]", &r, 3)),
        row(("error [m]", &off, 3)),
        heading(["roll", "pitch", "yaw"]),
        row(("attitude [rad]", &measured.attitude_rad, 4)),
        row(("setpoint [rad]", &setpoint.attitude_rad, 4)),
        row(("rate [rad/s]", &measured.rate_b_rad_s, 4)),
        row(("rotors [rad/s]", &measured.rotor_speed_command_rad_s, 0)),
        modes(flight, thrust_n),
        fitting(error, width),
    ]
}

/// Which channel flies, which processes have failed, which faults act, and what happened last.
fn situation<'a>(flight: &WatchedFlight, width: u16) -> Vec<Line<'a>> {
    const TITLE: usize = 14;
    let mut lines = Vec::new();
    let mut add = |title: &str, text: &str, style: Style| {
        let rows = wrapped(&format!("{title:<TITLE$}{text}"), width, TITLE);
        lines.extend(rows.into_iter().map(|row| Line::styled(row, style)));
    };
    let time = |tick| format!("{:.3} s", flight.run.flight_time_s(tick));
    let channels = flight.run.channels.max(1);
    let channel = match flight.channel {
        None => "no command was seen yet".into(),
        Some((channel, since)) => {
            let since = since.map_or_else(|| "before you watched".into(), time);
            format!("{channel} of {channels} flies, since {since}")
        }
    };
    let (failed, restarted) = (flight.supervision.failed, flight.supervision.restarted);
    let processes = match failed {
        0 => "none failed".into(),
        _ => format!("{failed} failed, {restarted} restarted"),
    };
    let text = format!("{channel}; processes: {processes}");
    add("channel", &text, if failed == 0 { PLAIN } else { BAD });
    let faults = flight.active_faults();
    if faults.is_empty() {
        add("faults", "none acts", PLAIN);
    }
    for (what, rest_s) in faults {
        let rest = rest_s.map_or_else(
            || "until it is ended".into(),
            |rest_s| format!("for {rest_s:.1} s more"),
        );
        add("faults", &format!("{what} {rest}"), BAD);
    }
    for (i, event) in flight.events(1).into_iter().take(EVENTS).enumerate() {
        let title = if i == 0 { "events" } else { "" };
        add(
            title,
            &format!("{} {}", time(event.tick), event.text),
            PLAIN,
        );
    }
    lines
}

fn modes<'a>(flight: &WatchedFlight, thrust_n: f64) -> Line<'a> {
    let mut line = Line::from(format!("{:<14}{thrust_n:>8.3}  mode  ", "thrust [N]"));
    let (Some(wrench), Some(speeds)) = (&flight.wrench, &flight.rotor_speeds) else {
        line.push_span("-");
        return line;
    };
    for (stage, mode) in [("inner ", wrench.mode), ("   mixer ", speeds.mode)] {
        let word = Mode::from_wire(mode).map_or("unknown", Mode::name);
        line.push_span(stage);
        line.push_span(Span::styled(word, good_or_bad(word == "fresh")));
    }
    if speeds.saturated == 1 {
        line.push_span(Span::styled("   saturated", BAD));
    }
    line
}

/// The horizon as seen from the airframe: it rises to the right if the left side is up.
fn horizon(
    flight: &WatchedFlight,
) -> Canvas<'_, impl Fn(&mut ratatui::widgets::canvas::Context<'_>)> {
    /// Pitch at the upper edge [rad].
    const PITCH_RAD: f64 = 0.8;
    /// Half the width of the picture; its height is 2. A cell is half as wide as it is high.
    const HALF_WIDTH: f64 = 26.0 / 12.0 / 2.0;
    let attitude = flight.state.unwrap_or_default().measured.attitude_rad;
    let setpoint = flight.setpoint.unwrap_or_default().attitude_rad;
    let stroke = |[roll, pitch, _]: [f64; 3], reach: f64, color: Color| {
        let (sin, cos) = roll.sin_cos();
        let rise = pitch / PITCH_RAD;
        Stroke::new(
            -reach * cos,
            rise - reach * sin,
            reach * cos,
            rise + reach * sin,
            color,
        )
    };
    Canvas::default()
        .marker(Marker::Braille)
        .x_bounds([-HALF_WIDTH, HALF_WIDTH])
        .y_bounds([-1.0, 1.0])
        .paint(move |context| {
            context.draw(&stroke(setpoint, 0.45, Color::Magenta));
            context.draw(&stroke(attitude, HALF_WIDTH, Color::Blue));
            context.layer();
            // The airframe.
            context.print(-0.4, 0.0, "--");
            context.print(0.0, 0.0, "+");
            context.print(0.3, 0.0, "--");
        })
}

/// Deadlines, all latencies, and the histogram of the selected one.
fn latency_page(flight: &WatchedFlight, selected: usize, region: &mut Region<'_, '_>) {
    /// Height of the histogram with its heading and its axis.
    const HISTOGRAM: u16 = 7;
    let (run, statistics) = (&flight.run, &flight.statistics);
    let (_, not_fresh) = flight.verdicts();
    let (count, per_million) = (not_fresh.ticks, not_fresh.per_million);
    let all_flight = format!("{NOT_FRESH} {count}, {per_million:.1} per million");
    let parts = format!(
        "{}; deadlines missed {}",
        not_fresh.parts(),
        run.deadlines_missed
    );
    region.put(vec![
        Line::styled(all_flight, good_or_bad(count == 0)),
        Line::styled(parts, FAINT),
    ]);
    let height = region.area.height;
    let histogram_height = match height {
        0..12 => 0,
        height => HISTOGRAM.max(height / 3),
    };
    let width = region.area.width;
    let row = |name: &str, cells: [String; 6]| {
        let cells = cells.iter().map(|cell| format!("{cell:>10}"));
        fitting([format!("{name:<18}")].into_iter().chain(cells), width)
    };
    let heading = ["p50", "p90", "p99", "p99.9", "max", "count"].map(str::to_owned);
    let series_row = |series: &Series| {
        let histogram = statistics.series.flight(*series);
        let Some(histogram) = histogram.filter(|histogram| !histogram.is_empty()) else {
            return row(&series.name(), ["-"; 6].map(str::to_owned));
        };
        let s = Statistics::of("", histogram);
        let p999 = known(s.p999_us.map(us));
        let [p50, p90, p99, max] = [s.p50_us, s.p90_us, s.p99_us, s.max_us].map(us);
        row(
            &series.name(),
            [p50, p90, p99, p999, max, s.count.to_string()],
        )
    };
    let all = Series::all();
    let room = usize::from(height - histogram_height).saturating_sub(1);
    let [table, plot] =
        Layout::vertical([Constraint::Min(0), Constraint::Length(histogram_height)])
            .areas(region.area);
    region.area = table;
    let rows = all.iter().map(series_row).collect();
    region.put_table(row("[us]", heading), rows, selected, room);
    if let Some(histogram) = statistics.series.flight(all[selected])
        && histogram_height > 0
    {
        region.area = plot;
        put_histogram(&all[selected].name(), histogram, region);
    }
}

fn put_histogram(name: &str, histogram: &Histogram<u64>, region: &mut Region<'_, '_>) {
    let title = format!("{name} [us], counts on a logarithmic scale");
    region.put(vec![Line::default(), Line::styled(title, HEADING)]);
    if histogram.is_empty() {
        return;
    }
    let (counts, labels) = log_bins(histogram, usize::from(region.area.width));
    let heights: Vec<f64> = counts.iter().map(|it| (*it as f64 + 1.0).log10()).collect();
    let most = heights.iter().copied().fold(0.0, f64::max);
    let [plot, axis] =
        Layout::vertical([Constraint::Min(0), Constraint::Length(1)]).areas(region.area);
    region.area = plot;
    region.put_bars(&heights, [0.0, most]);
    region.area = axis;
    region.put(vec![Line::styled(labels, FAINT)]);
}

/// Counts in bins of equal width on a logarithmic axis, over whole decades of microseconds, and the decades' labels.
fn log_bins(histogram: &Histogram<u64>, bins: usize) -> (Vec<u64>, String) {
    let first = decade(histogram.min()).floor().max(-1.0) as i32;
    let last = (decade(histogram.max()).ceil() as i32).max(first + 1);
    let decades = last - first;
    let mut counts = vec![0; bins];
    for value in histogram.iter_recorded() {
        let place = decade(value.value_iterated_to()) - f64::from(first);
        let bin = (place / f64::from(decades) * bins as f64).max(0.0) as usize;
        counts[bin.min(bins - 1)] += value.count_at_value();
    }
    let mut labels = String::new();
    for (number, power) in (first..last).enumerate() {
        let place = bins * number / decades as usize;
        let label = match power {
            6.. => format!("|{} s", 10_u64.pow(power.unsigned_abs() - 6)),
            3.. => format!("|{} ms", 10_u64.pow(power.unsigned_abs() - 3)),
            0.. => format!("|{} us", 10_u64.pow(power.unsigned_abs())),
            _ => "|100 ns".into(),
        };
        labels = format!("{labels:<place$}{label}");
    }
    (counts, labels)
}

/// Logarithm to base 10 of a time in microseconds.
fn decade(ns: u64) -> f64 {
    (ns.max(1) as f64 / 1e3).log10()
}

/// V and V_th, estimates compared with true values, violations by cause.
fn theorem_page(flight: &WatchedFlight, region: &mut Region<'_, '_>) {
    const CHART: u16 = 8;
    /// The paper's symbols of [`messages::parameters::ESTIMATED`].
    const SYMBOLS: [&str; 3] = ["I_R kg m^2", "k_r N m s", "delta rad/s^2"];
    if let Some(why) = flight.laws.without_theorem.map(no_theorem) {
        let text = format!("The theorem is not applicable: {why}.");
        return region.put_wrapped(vec![Line::from(text)]);
    }
    let (Some(wrench), Some(monitor)) = (&flight.wrench, &flight.monitor) else {
        return region.put(vec![Line::from("the monitor has published no result yet")]);
    };
    let width = region.area.width;
    let theorem = flight.statistics.stages.theorem.section();
    let mut lines = vec![theorem_verdict(&theorem, flight.lost_at(), width)];
    lines.extend(lyapunov_values(flight, monitor, width));
    let row = |name: &str, cells: [&str; 3], mark: Option<Line<'static>>| {
        let cells = cells.map(|cell| Line::from(format!("{cell:>11}")));
        let name = Line::from(format!("{name:<14}"));
        fitting([name].into_iter().chain(cells).chain(mark), width)
    };
    lines.push(row("estimates", ["estimated", "true", "error"], None).style(HEADING));
    let estimates = adaptive::estimate(&wrench.telemetry);
    for (i, (symbol, estimate)) in SYMBOLS.iter().zip(estimates).enumerate() {
        let known = theorem.estimates.get(i);
        let truth = known.map_or(0.0, |known| known.actual);
        let [estimate, truth] = [estimate, truth].map(|value| format!("{value:.4e}"));
        let error = format!("{:.2e}", monitor.estimate_error[i]);
        let is_found = known.is_some_and(|known| known.found);
        let mark = is_found.then(|| Line::styled("  found", GOOD));
        lines.push(row(symbol, [&estimate, &truth, &error], mark));
    }
    region.put(lines);
    region.put(causes(monitor, region.area.height >= 8, width));
    let converged = ["did not hold so far", "held"][usize::from(theorem.converged)];
    region.put(vec![Line::from(format!(
        "excitation {:.1e} e-folds in 10 s, least {:.1e}; (18) {converged}",
        theorem.excitation, theorem.excitation_least
    ))]);
    // The explanation, if enough room remains for the chart.
    let Rect { width, height, .. } = region.area;
    let words = theorem.convergence.len() as u16;
    let explanation = words.div_ceil(width.max(1)) + 1;
    if height >= explanation + CHART {
        let area = region.split(explanation);
        let frame = &mut *region.frame;
        Region { frame, area }.put_wrapped(vec![Line::from(theorem.convergence)]);
    }
    put_v_th(flight, region);
}

fn theorem_verdict<'a>(theorem: &Theorem, lost_at: Option<u64>, width: u16) -> Line<'a> {
    if let Some(tick) = lost_at {
        let held = ["DID NOT HOLD", "held"][usize::from(theorem.holds)];
        let words = format!("theorem {held} up to tick {tick}; unchecked since: no recorder");
        return Line::styled(words, BAD);
    }
    let holds = ["DOES NOT HOLD", "holds"][usize::from(theorem.holds)];
    let holds = Line::styled(format!("theorem {holds}"), good_or_bad(theorem.holds));
    let unexplained = format!(": {} unexplained", theorem.unexplained());
    let steps = format!(" of {} steps", theorem.ticks_checked);
    fitting([holds, unexplained.into(), steps.into()], width)
}

/// V, V_th and the rate error: current values and, if there is room, their history.
fn lyapunov_values<'a>(flight: &WatchedFlight, m: &Monitor, width: u16) -> [Line<'a>; 3] {
    let error = flight.statistics.flight().rate_error_final_rad_s;
    let (v, rate, predicted) = ("rad^2/s^2", "rad/s", m.descent_predicted);
    let fell = format!("  fell by {:>10.2e} of {predicted:.2e}", m.descent);
    let history = |first: &str, [a, b]: [f64; 2], second: &str| {
        let second = format!("  {second} {b:>10.2e}");
        [format!("  {first:<6} {a:>10.2e}"), second]
    };
    let changes = history("change", [m.v_change, m.v_change_bound], "at most");
    let [first, _] = history("first", [m.v_th_start, 0.0], "");
    let errors = [m.rate_error_rms_rad_s, m.rate_error_max_rad_s];
    [
        ("V", Some(m.v), v, changes),
        ("V_th", Some(m.v_th), v, [first, fell]),
        ("|e|", error, rate, history("rms", errors, "largest")),
    ]
    .map(|(name, now, unit, history)| {
        let now = known(now.map(|now| format!("{now:.3e}")));
        let now = format!("{name:<5}{now:>10} {unit:<9}");
        fitting([now].into_iter().chain(history), width)
    })
}

/// Steps by cause, for rises of V_th and of V.
fn causes<'a>(monitor: &Monitor, all: bool, width: u16) -> Vec<Line<'a>> {
    let row = |name: &str, [v_th, v]: [&str; 2]| format!("{name:<20}{v_th:>9}{v:>9}");
    let heading = row("violations by cause", ["V_th", "V"]);
    let heading = [heading.into(), Line::from("  V is not judged")];
    let mut lines = vec![fitting(heading, width).style(HEADING)];
    for cause in Cause::ALL {
        let steps = monitor.violations[cause as usize];
        let unjudged = monitor.v_above_bound[cause as usize];
        let is_unexplained = cause == Cause::Unexplained;
        if is_unexplained || (all && steps + unjudged > 0) {
            let style = if is_unexplained && steps > 0 {
                BAD
            } else {
                PLAIN
            };
            let [steps, unjudged] = [steps, unjudged].map(|steps| steps.to_string());
            let text = row(cause.name(), [&steps, &unjudged]);
            lines.push(Line::styled(text, style));
        }
    }
    lines
}

fn put_v_th(flight: &WatchedFlight, region: &mut Region<'_, '_>) {
    /// Decades below the largest V_th that the chart shows.
    const DECADES: f64 = 6.0;
    let width = region.area.width;
    let points = flight.v_th.newest(usize::from(width));
    let logarithm = |v: f64| v.max(f64::MIN_POSITIVE).log10();
    let points: Vec<f64> = points.into_iter().map(logarithm).collect();
    let Some(most) = points.iter().copied().reduce(f64::max) else {
        return;
    };
    if region.area.height >= 3 {
        let (span_s, v_th) = (f64::from(width) * POINT_S, 10_f64.powf(most));
        let title = format!(
            "V_th, last {span_s:.0} s; full height {v_th:.1e} rad^2/s^2, {DECADES:.0} decades"
        );
        region.put(vec![Line::styled(title, HEADING)]);
        region.put_bars(&points, [most - DECADES, most]);
    }
}

/// The current parameters, and the input line that changes them.
fn plant_page(flight: &WatchedFlight, page: &ParameterPage, region: &mut Region<'_, '_>) {
    // An error message may need two lines.
    let foot = if region.area.height >= 12 { 2 } else { 1 };
    let (width, height) = (region.area.width, usize::from(region.area.height));
    let room = height.saturating_sub(foot + 1);
    let cells = |unit: &str, [nominal, min, max]: [String; 3]| {
        // A long unit uses the room of the nominal value, which is 0 in that row.
        let rest = 17_usize.saturating_sub(unit.len().max(8));
        let nominal = format!("  {unit:<8}{nominal:>rest$}");
        [nominal, format!("{min:>9}"), format!("{max:>9}")]
    };
    let row = |it: Row| {
        let value = it.in_force.unwrap_or(it.nominal);
        let (mark, style) = match value == it.nominal {
            true => (' ', PLAIN),
            false => ('*', BAD),
        };
        let name = format!("{:<24}{:>10}{mark}", it.name, number(value));
        let range = [number(it.nominal), bound(it.min), bound(it.max)];
        let cells = cells(it.unit, range);
        fitting([name].into_iter().chain(cells), width).style(style)
    };
    let heading = format!("{:<24}{:>11}", "parameter", "in force");
    let columns = cells("unit", ["nominal", "min", "max"].map(str::to_owned));
    let heading = fitting([heading].into_iter().chain(columns), width);
    let rows = rows(&flight.airframe, Some(&flight.active)).map(row).into();
    region.put_table(heading, rows, page.selected, room);
    region.split(u16::from(usize::from(region.area.height) > foot));
    region.put_wrapped(dialogue(flight, page));
}

/// What is typed, the last answer, or what the selected parameter means.
fn dialogue<'a>(flight: &WatchedFlight, page: &'a ParameterPage) -> Vec<Line<'a>> {
    let spec = page.parameter().spec();
    let mut lines = Vec::new();
    if let Some(typed) = &page.typed {
        let range = flight.airframe.range(spec.parameter);
        let prompt = match page.is_fault {
            true => "fault, as in state.drop=0.1 for 1s: ".into(),
            false => format!(
                "{} [{}], {:?} to {:?}: ",
                spec.name, spec.unit, range.min, range.max
            ),
        };
        let typed = Span::styled(format!("{typed}_"), HEADING);
        lines.push(Line::from_iter([Span::raw(prompt), typed]));
    } else if page.waits {
        lines.push(Line::from("waits for the plant's answer"));
    }
    match &page.result {
        Some(Ok(text)) => lines.push(Line::styled(text.as_str(), GOOD)),
        Some(Err(text)) => lines.push(Line::styled(text.as_str(), BAD)),
        None if lines.is_empty() => {
            let last = flight.newest_swap.as_ref();
            let last = last.map(|swap| format!("; the last: {}", render::sentences::swap(swap)));
            let swaps = format!(
                "* is not nominal; parameter changes so far {}{}",
                flight.active.parameter_epoch,
                last.unwrap_or_default()
            );
            lines.extend([
                Line::styled(spec.meaning, FAINT),
                Line::styled(swaps, FAINT),
            ]);
        }
        None => {}
    }
    lines
}

/// The real-time rights that each process requested and got.
fn real_time_page(flight: &WatchedFlight, scrolled: &Cell<usize>, region: &mut Region<'_, '_>) {
    let width = region.area.width;
    let room = (usize::from(width) / COLUMN).saturating_sub(1).max(1);
    // The plant first: its delays matter most.
    let all: Vec<(&Replica, &Status)> = flight.statuses.iter().collect();
    let mut lines: Vec<Line<'_>> = all.chunks(room).flat_map(rights).collect();
    // Each refusal once, with its remedy.
    for step in RealtimeStep::ALL {
        let mut grants = all.iter().map(|(_, status)| status.grants.of(step));
        if let Some(refused) = grants.find(|grant| grant.asked == 1 && !grant.granted()) {
            let (why, remedy) = (errno_text(refused.errno), remedy(step, refused.errno));
            let rows = wrapped(&format!("{why}: {remedy}"), width, 2);
            lines.extend(rows.into_iter().map(|row| Line::styled(row, FAINT)));
        }
    }
    region.put_scrolled(lines, scrolled);
}

/// Width of a role's column.
const COLUMN: usize = 12;

/// A table of roles.
fn rights(statuses: &[(&Replica, &Status)]) -> Vec<Line<'static>> {
    let row = |title: &str, text: &dyn Fn(&Replica, &Status) -> String| {
        let cell =
            |(role, status): &(&Replica, &Status)| format!("{:<COLUMN$}", text(role, status));
        let cells: String = statuses.iter().map(cell).collect();
        Line::from(format!("{title:<COLUMN$}{cells}"))
    };
    let mut lines = vec![
        row("", &|role, _| role.to_string()).style(HEADING),
        row("process", &|_, status| status.pid.to_string()),
        row("phase", &|_, status| {
            format!("{:?}", status.phase()).to_lowercase()
        }),
        row("scheduling", &|_, status| role_section(status).scheduling),
    ];
    for step in RealtimeStep::ALL {
        let title = serde_json::to_value(step).unwrap_or_default();
        let title = title.as_str().unwrap_or_default();
        let mut line = Line::from(format!("{title:<COLUMN$}"));
        for (role, status) in statuses {
            let grant = status.grants.of(step);
            let is_affinity = step == RealtimeStep::Affinity;
            let value = match (is_affinity, role.role) {
                (true, Role::Record) => format!("not {} ", grant.value),
                (false, _) if grant.value == 0 => String::new(),
                _ => format!("{} ", grant.value),
            };
            let (text, style) = match (grant.asked, grant.granted()) {
                (1, true) => (value + "ok", GOOD),
                (1, false) => (value + "REFUSED", BAD),
                _ => ("-".into(), FAINT),
            };
            line.push_span(Span::styled(format!("{text:<COLUMN$}"), style));
        }
        lines.push(line);
    }
    lines.extend([
        row("ticks", &|_, status| status.ticks_run.to_string()),
        row("skipped", &|_, status| status.ticks_skipped.to_string()),
        row("stale", &|_, status| status.ticks_stale.to_string()),
        row("rejected", &|_, status| {
            status.rejections.total().to_string()
        }),
    ]);
    lines
}

fn laws_page(flight: &WatchedFlight, scrolled: &Cell<usize>, region: &mut Region<'_, '_>) {
    let width = region.area.width;
    let row = |name: &str, [last, min, max]: [&str; 3], unit: &str| {
        let cells = [
            format!("{name:<27.27}{last:>11}"),
            format!("{min:>13}"),
            format!("{max:>13}"),
            format!(" {unit}"),
        ];
        fitting(cells, width)
    };
    let signal_row = |signal: &SignalSection| {
        let cell = |value: Option<f64>| known(value.map(|value| format!("{value:.4e}")));
        let cells = [signal.last, signal.min, signal.max].map(cell);
        let name = format!(" {}", signal.name);
        row(&name, cells.each_ref().map(String::as_str), &signal.unit)
    };
    let mut lines = Vec::new();
    for (role, statistics) in LAW_ROLES
        .into_iter()
        .zip(&flight.statistics.stages.telemetry)
    {
        let signals = statistics.section();
        let title = format!("{role} {}", flight.settings.law_name(role));
        lines.push(match signals.is_empty() {
            true => Line::from_iter([
                Span::styled(title, HEADING),
                Span::styled("   publishes no signals", FAINT),
            ]),
            false => row(&title, ["now", "smallest", "largest"], "").style(HEADING),
        });
        lines.extend(signals.iter().map(signal_row));
    }
    region.put_scrolled(lines, scrolled);
}
