//! Flights of the same laws in several cases: Markdown tables, a page, a picture, and CSV.

use crate::comparison::{conditions, significant, thousandths};
use crate::document::{Block, Cell, Document, Section, Table, known};
use crate::plot::STYLE;
use analysis::comparison::{Comparison, ErrorFigures, Figures, Laws, Outcome, SETTLING_S};
use analysis::phrase::list;
use analysis::statistics::{median, median_interval};
use maud::{Markup, PreEscaped, html};

/// Rows in which no law changes its commands by more are left out of what tells of that [rad/s].
const QUIET_RAD_S: f64 = 0.1;

pub struct Cases {
    pub title: String,
    /// Whether errors count from the fault on; else from [`SETTLING_S`] after it.
    pub from_fault: bool,
    /// Cases, each with its name and at least one flight of the same laws.
    pub rows: Vec<(String, Vec<Comparison>)>,
}

/// Text of a cell, and the figure by which the best of a row is found: the smallest is.
type CellFigure = (String, Option<f64>);

/// Title of a table, the cell for the flights of a combination, and the figure below which a row is left out.
struct Measure(String, fn(&[&Outcome]) -> CellFigure, Option<f64>);

impl Cases {
    fn first(&self) -> Option<&Comparison> {
        self.rows.first().and_then(|(_, flights)| flights.first())
    }

    fn measures(&self) -> [Measure; 2] {
        let bounds = self
            .first()
            .map(|it| (it.flight.bound_m, it.flight.bound_yaw_rad));
        let (bound_m, bound_yaw_rad) = bounds.unwrap_or_default();
        let (error, cell): (String, fn(&[&Outcome]) -> CellFigure) = match self.from_fault {
            true => (
                "true position error from the fault on [mm]: rms / peak".into(),
                from_fault,
            ),
            false => {
                let from = format!("from {SETTLING_S} s after the fault on [mm]");
                (format!("worst true position error {from}"), lasting)
            }
        };
        let error = format!(
            "{error} / time until it stays below {bound_m} m, and the yaw error below {bound_yaw_rad} rad [s]"
        );
        let flights = self.rows.first().map_or(1, |(_, flights)| flights.len());
        let of_flights = match flights {
            1 => String::new(),
            _ => format!(" ({flights} flights: median with its 95 % interval / largest)"),
        };
        let error = error + &of_flights;
        let change = format!(
            "change of a rotor's command in a tick, rms of the flight [rad/s], where it is above {QUIET_RAD_S}"
        );
        [
            Measure(error, cell, None),
            Measure(change, agitation, Some(QUIET_RAD_S)),
        ]
    }

    /// A table for each measure and each outer law with its mixer; `bold` marks what is best in its row.
    fn tables(&self, bold: fn(&str) -> String) -> Vec<(String, Table)> {
        let Some(first) = self.first() else {
            return Vec::new();
        };
        let group = |laws: &Laws| (laws.outer.clone(), laws.mixer.clone());
        let mut groups: Vec<_> = first.outcomes.iter().map(|it| group(&it.laws)).collect();
        groups.dedup();
        let mut tables = Vec::new();
        for Measure(title, cell, least) in self.measures() {
            for of in &groups {
                let is_of = |outcome: &&Outcome| group(&outcome.laws) == *of;
                let rows = self.rows.iter().filter_map(|(name, flights)| {
                    let combinations =
                        (0..first.outcomes.len()).filter(|it| is_of(&&first.outcomes[*it]));
                    let of_flights = |it: usize| -> Vec<&Outcome> {
                        flights.iter().map(|flight| &flight.outcomes[it]).collect()
                    };
                    let figures: Vec<CellFigure> =
                        combinations.map(|it| cell(&of_flights(it))).collect();
                    let cells = cells(&figures, least, bold)?;
                    Some([Cell::from(name)].into_iter().chain(cells).collect())
                });
                let laws = first.outcomes.iter().filter(is_of);
                let laws = laws.map(|it| format!("`{}`", it.laws.inner));
                let columns = ["fault".to_owned()].into_iter().chain(laws);
                let (outer, mixer) = of;
                let mixer = match first.mixers_differ() {
                    true => format!(", mixer `{mixer}`"),
                    false => String::new(),
                };
                let title = format!("Outer law `{outer}`{mixer}: {title}");
                tables.push((title, Table::new(columns, rows)));
            }
        }
        tables
    }

    /// All flights in order, each with the name of its case.
    fn flights(&self) -> impl Iterator<Item = (&String, &Comparison)> {
        let rows = self.rows.iter();
        rows.flat_map(|(name, flights)| flights.iter().map(move |it| (name, it)))
    }

    pub fn markdown(&self) -> String {
        let tables = self.tables(|text| format!("**{text}**")).into_iter();
        let tables = tables.map(|(title, mut table)| {
            for row in &mut table.rows {
                row[0].text = row[0].text.replace('|', "\\|");
            }
            let table = format!("\n{}", table.markdown()).replace(" | ", "|");
            let table = table.replace("\n| ", "\n|").replace(" |\n", "|\n");
            format!("{title}\n{table}")
        });
        tables.collect::<Vec<_>>().join("\n")
    }

    pub fn document(&self) -> Document {
        let first = self.first();
        let flown = first.map_or(String::new(), |it| conditions(&it.flight));
        let note = "A cell is the darker the larger its figure is beside the best of its row: the darkest are 100 times \
                    as large, or lost.";
        let tables = self.tables(str::to_owned).into_iter();
        let ids = ["error", "effort"].into_iter().cycle();
        let mut sections: Vec<Section> = ids
            .zip(tables)
            .map(|(id, (title, mut table))| {
                for column in &mut table.columns {
                    *column = column.replace('`', "");
                }
                Section::new(id, title.replace('`', ""), vec![Block::Table(table)])
            })
            .collect();
        let case = |(name, comparison): (&String, &Comparison)| {
            let flight = &comparison.flight;
            let faults = flight.faults.iter();
            let faults = list(faults.map(|it| format!("{} at {:.3} s", it.what, it.time_s)));
            format!("{name}: {}; {faults}", conditions(flight))
        };
        let items = Block::Items(self.flights().map(case).collect());
        sections.push(Section::new("cases", "Cases", vec![items]));
        Document {
            title: format!("{}, {flown}", self.title),
            heading: self.title.clone(),
            build: first.map_or(String::new(), |it| it.build.to_string()),
            lead: vec![Block::Note(note.into())],
            sections,
            ..Document::default()
        }
    }

    /// The first table as a picture, with the first figure of each cell.
    pub fn picture(&self) -> String {
        let [left, column, row_height, top] = [200.0, 78.0, 22.0, 76.0];
        let Some((title, table)) = self.tables(str::to_owned).into_iter().next() else {
            return String::new();
        };
        let subtitle = title.replace('`', "");
        let subtitle = subtitle.split(" / ").next().unwrap_or_default();
        // A character is at most so wide in each of the two fonts.
        let [of_title, of_subtitle] = [(&*self.title, 10.0), (subtitle, 7.5)]
            .map(|(text, wide)| 24.0 + wide * text.chars().count() as f64);
        let of_table = left + column * (table.columns.len() - 1) as f64 + 16.0;
        let width = of_table.max(of_title).max(of_subtitle);
        let height = top + row_height * table.rows.len() as f64 + 16.0;
        let cell = |x: usize, y: usize, cell: &Cell| -> Markup {
            let (x, y) = (left + column * x as f64, top + row_height * y as f64);
            let shade = cell.shade.unwrap_or_default();
            let text = cell.text.split(['/', '[']).next().unwrap_or_default();
            html! {
                rect x=(x) y=(y) width=(column - 2.0) height=(row_height - 2.0)
                    style=(format!("fill:rgb(213 94 0 / {shade:.0}%)")) {}
                text.below x=(x + column / 2.0) y=(y + 14.0) { (text) }
            }
        };
        let picture = html! {
            svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {width} {height}")) width=(width) height=(height) {
                style { (PreEscaped(STYLE)) ".card { fill: var(--card); } svg text { fill: var(--ink); }" }
                rect.card x="0" y="0" width=(width) height=(height) {}
                text x="12" y="22" style="font-size:15px;font-weight:600" { (self.title) }
                text x="12" y="42" { (subtitle) }
                @for (x, law) in table.columns.iter().skip(1).enumerate() {
                    text.below x=(left + column * (x as f64 + 0.5)) y=(top - 8.0) { (law.replace('`', "")) }
                }
                @for (y, row) in table.rows.iter().enumerate() {
                    text x="12" y=(top + row_height * y as f64 + 14.0) { (row[0].text) }
                    @for (x, it) in row.iter().skip(1).enumerate() { (cell(x, y, it)) }
                }
            }
        };
        picture.into_string()
    }

    pub fn csv(&self) -> String {
        let mut text = "case,seed,fault_s,trajectory,preset,outer,inner,mixer,outputs,lost_s,rms_m,worst_m,rms_from_fault_m,\
                        worst_from_fault_m,worst_after_5s_m,recovery_s,agitation_rad_s,saturated_percent,power_hover,\
                        yaw_error_rms_rad,yaw_error_max_rad,tilt_error_rms_rad,tilt_error_max_rad\n"
            .to_owned();
        for (name, comparison) in self.flights() {
            let fault = comparison.flight.faults.first();
            let fault_s = fault.map_or(String::new(), |it| it.time_s.to_string());
            let seed = comparison.flight.seed.to_string();
            for outcome in &comparison.outcomes {
                let (it, laws) = (&outcome.figures, &outcome.laws);
                let (trajectory, preset) = (&comparison.flight.trajectory, &outcome.preset);
                let (outer, inner, mixer) = (&laws.outer, &laws.inner, &laws.mixer);
                let words = [
                    name,
                    &seed,
                    &fault_s,
                    trajectory,
                    preset,
                    outer,
                    inner,
                    mixer,
                    &outcome.outputs,
                ];
                let words = words.map(|word| format!("\"{}\"", word.replace('"', "\"\"")));
                let numbers = [
                    outcome.lost_s,
                    Some(it.error.rms_m),
                    Some(it.error.worst_m),
                    it.error_from_fault.map(|it| it.rms_m),
                    it.error_from_fault.map(|it| it.worst_m),
                    it.error_after.map(|it| it.worst_m),
                    it.longest_recovery_s(),
                    Some(it.effort.agitation_rad_s),
                    Some(it.effort.saturated_percent),
                    Some(it.effort.power),
                    it.yaw_error.map(|it| it.rms_rad),
                    it.yaw_error.map(|it| it.max_rad),
                    it.tilt_error.map(|it| it.rms_rad),
                    it.tilt_error.map(|it| it.max_rad),
                ];
                let numbers = numbers.map(|it| it.map_or(String::new(), |it| it.to_string()));
                text += &format!("{},{}\n", words.join(","), numbers.join(","));
            }
        }
        text
    }
}

/// The cells of a row, unless none of its figures is above `least`.
fn cells(
    figures_of_row: &[CellFigure],
    least: Option<f64>,
    bold: fn(&str) -> String,
) -> Option<Vec<Cell>> {
    /// Shade of a cell whose figure is ten times the best [%].
    const TENFOLD: f64 = 35.0;
    let figures = || figures_of_row.iter().filter_map(|(_, figure)| *figure);
    if least.is_some_and(|least| !figures().any(|figure| figure > least)) {
        return None;
    }
    let best = figures().min_by(f64::total_cmp).unwrap_or_default();
    let cell = |(text, figure): &CellFigure| match figure {
        // Figures that print alike are both the best.
        Some(figure) if significant(*figure) == significant(best) => bold(text).into(),
        figure => {
            let times = figure.map_or(f64::INFINITY, |figure| figure / best);
            Cell {
                text: text.clone(),
                shade: Some((TENFOLD * times.log10()).clamp(0.0, 2.0 * TENFOLD)),
                ..Cell::default()
            }
        }
    };
    Some(figures_of_row.iter().map(cell).collect())
}

fn tracking(
    outcomes: &[&Outcome],
    error: fn(&Figures) -> Option<ErrorFigures>,
    of: &[fn(&ErrorFigures) -> f64],
) -> CellFigure {
    let lost: Vec<f64> = outcomes.iter().filter_map(|it| it.lost_s).collect();
    if let Some(first_s) = lost.iter().copied().min_by(f64::total_cmp) {
        let share = match outcomes.len() {
            1 => String::new(),
            all => format!(" {} of {all}/first", lost.len()),
        };
        return (format!("lost{share} at {first_s:.1} s"), None);
    }
    let figures = || outcomes.iter().map(|it| &it.figures);
    // Without a fault, the whole flight counts; a flight that ended too soon has no figure.
    let errors = figures().map(|it| {
        let whole = it.recovery_s.is_empty().then_some(it.error);
        error(it).or(whole)
    });
    let errors: Option<Vec<ErrorFigures>> = errors.collect();
    let figures_m = |of: &fn(&ErrorFigures) -> f64| -> Option<Vec<f64>> {
        errors
            .as_ref()
            .map(|errors| errors.iter().map(of).collect())
    };
    let (first, others) = (figures_m(&of[0]), &of[1..]);
    let others = others
        .iter()
        .map(|of| figures_m(of).map(|it| thousandths(largest(&it))));
    let recoveries = figures().map(Figures::longest_recovery_s);
    let recovery: Option<Vec<f64>> = recoveries.collect();
    let recovery = recovery.map(|it| format!("{:.2}", largest(&it)));
    let text = first.as_deref().map(|values| typical(values, thousandths));
    let texts = [text]
        .into_iter()
        .chain(others)
        .chain([recovery])
        .map(known);
    let figure_mm = first.map(|values| 1e3 * median(&values));
    (texts.collect::<Vec<_>>().join("/"), figure_mm)
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

/// The median, with its interval where that prints as more than one number.
fn typical(values: &[f64], print: fn(f64) -> String) -> String {
    let middle = print(median(values));
    let interval = median_interval(values).map(|it| [it.low, it.high].map(print));
    match interval {
        Some([low, high]) if low != high => format!("{middle} [{low} {high}]"),
        _ => middle,
    }
}

fn lasting(outcomes: &[&Outcome]) -> CellFigure {
    tracking(outcomes, |it| it.error_after, &[|it| it.worst_m])
}

fn from_fault(outcomes: &[&Outcome]) -> CellFigure {
    tracking(
        outcomes,
        |it| it.error_from_fault,
        &[|it| it.rms_m, |it| it.worst_m],
    )
}

fn agitation(outcomes: &[&Outcome]) -> CellFigure {
    if outcomes.iter().any(|it| it.lost.is_some()) {
        return ("lost".into(), None);
    }
    let changes = outcomes.iter().map(|it| it.figures.effort.agitation_rad_s);
    let changes: Vec<f64> = changes.collect();
    (typical(&changes, significant), Some(median(&changes)))
}
