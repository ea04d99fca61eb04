//! Flights of the same laws in several cases: Markdown tables, a page, a picture, and CSV.

use crate::comparison::{conditions, significant, thousandths};
use crate::document::{Block, Cell, Document, Section, Table, known};
use crate::plot::STYLE;
use analysis::comparison::{Comparison, ErrorFigures, Laws, Outcome, SETTLING_S};
use maud::{Markup, PreEscaped, html};

/// Rows in which no law changes its commands by more are left out of what tells of that [rad/s].
const QUIET_RAD_S: f64 = 0.1;

pub struct Cases {
    pub title: String,
    /// Whether errors count from the fault on; else from [`SETTLING_S`] after it.
    pub from_fault: bool,
    /// Flights of the same laws, each with the name of its case.
    pub rows: Vec<(String, Comparison)>,
}

/// What a combination made of a question in words, and what the best of a row has least of.
type Answer = (String, Option<f64>);

/// A question, its answer, and the figure below which a row is left out.
struct Question(String, fn(&Outcome) -> Answer, Option<f64>);

impl Cases {
    fn questions(&self) -> [Question; 2] {
        let bound_m = self.rows.first().map_or(0.0, |(_, it)| it.flight.bound_m);
        let (error, answer): (String, fn(&Outcome) -> Answer) = match self.from_fault {
            true => (
                "true position error from the fault on [mm]: rms / peak".into(),
                from_fault,
            ),
            false => {
                let from = format!("from {SETTLING_S} s after the fault on [mm]");
                (format!("worst true position error {from}"), lasting)
            }
        };
        let error = format!("{error} / time until it stays below {bound_m} m [s]");
        let change = format!(
            "change of a rotor's command in a tick, rms of the flight [rad/s], where it is above {QUIET_RAD_S}"
        );
        [
            Question(error, answer, None),
            Question(change, agitation, Some(QUIET_RAD_S)),
        ]
    }

    /// A table for each question and each outer law with its mixer; `bold` marks what is best in its row.
    fn tables(&self, bold: fn(&str) -> String) -> Vec<(String, Table)> {
        let Some((_, first)) = self.rows.first() else {
            return Vec::new();
        };
        let group = |laws: &Laws| (laws.outer.clone(), laws.mixer.clone());
        let mut groups: Vec<_> = first.outcomes.iter().map(|it| group(&it.laws)).collect();
        groups.dedup();
        let mut tables = Vec::new();
        for Question(question, answer, least) in self.questions() {
            for of in &groups {
                let is_of = |outcome: &&Outcome| group(&outcome.laws) == *of;
                let rows = self.rows.iter().filter_map(|(name, comparison)| {
                    let outcomes = comparison.outcomes.iter().filter(is_of);
                    let answers: Vec<Answer> = outcomes.map(answer).collect();
                    let cells = cells(&answers, least, bold)?;
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
                let title = format!("Outer law `{outer}`{mixer}: {question}");
                tables.push((title, Table::new(columns, rows)));
            }
        }
        tables
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
        let first = self.rows.first().map(|(_, first)| first);
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
        let case = |(name, comparison): &(String, Comparison)| {
            let flight = &comparison.flight;
            let faults = flight.faults.iter();
            let faults = faults.map(|it| format!("{} at {:.3} s", it.what, it.time_s));
            let faults = faults.collect::<Vec<_>>().join(", ");
            format!("{name}: {}; {faults}", conditions(flight))
        };
        let items = Block::Items(self.rows.iter().map(case).collect());
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
            let text = cell.text.split('/').next().unwrap_or_default();
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
        let mut text = "case,trajectory,preset,outer,inner,mixer,outputs,lost_s,rms_m,worst_m,rms_from_fault_m,\
                        worst_from_fault_m,worst_after_5s_m,recovery_s,agitation_rad_s,saturated_percent,power_hover,\
                        yaw_error_rms_rad,yaw_error_max_rad,tilt_error_rms_rad,tilt_error_max_rad\n"
            .to_owned();
        for (name, comparison) in &self.rows {
            for outcome in &comparison.outcomes {
                let (it, laws) = (&outcome.figures, &outcome.laws);
                let (trajectory, preset) = (&comparison.flight.trajectory, &outcome.preset);
                let (outer, inner, mixer) = (&laws.outer, &laws.inner, &laws.mixer);
                let words = [
                    name,
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
                    it.recovery_s.last().copied().flatten(),
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
fn cells(answers: &[Answer], least: Option<f64>, bold: fn(&str) -> String) -> Option<Vec<Cell>> {
    /// How dark a cell is whose figure is ten times the best [%].
    const TENFOLD: f64 = 35.0;
    let figures = || answers.iter().filter_map(|(_, figure)| *figure);
    if least.is_some_and(|least| !figures().any(|figure| figure > least)) {
        return None;
    }
    let best = figures().min_by(f64::total_cmp).unwrap_or_default();
    let cell = |(text, figure): &Answer| match figure {
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
    Some(answers.iter().map(cell).collect())
}

fn tracking(
    outcome: &Outcome,
    error: Option<ErrorFigures>,
    of: &[fn(&ErrorFigures) -> f64],
) -> Answer {
    let figures = &outcome.figures;
    if let Some(time_s) = outcome.lost_s {
        return (format!("lost at {time_s:.1} s"), None);
    }
    // A row without a fault tells of the whole flight; one whose flight was over too soon, of nothing.
    let whole = figures.recovery_s.is_empty().then_some(figures.error);
    let error = error.or(whole);
    let errors = of
        .iter()
        .map(|of| known(error.as_ref().map(of).map(thousandths)));
    let recovery_s = figures.recovery_s.last().copied().flatten();
    let recovery = known(recovery_s.map(|time_s| format!("{time_s:.2}")));
    let text: Vec<String> = errors.chain([recovery]).collect();
    let figure_mm = error.as_ref().map(|error| 1e3 * of[0](error));
    (text.join("/"), figure_mm)
}

fn lasting(outcome: &Outcome) -> Answer {
    tracking(outcome, outcome.figures.error_after, &[|it| it.worst_m])
}

fn from_fault(outcome: &Outcome) -> Answer {
    let error = outcome.figures.error_from_fault;
    tracking(outcome, error, &[|it| it.rms_m, |it| it.worst_m])
}

fn agitation(outcome: &Outcome) -> Answer {
    let agitation_rad_s = outcome.figures.effort.agitation_rad_s;
    match outcome.lost {
        Some(_) => ("lost".into(), None),
        None => (significant(agitation_rad_s), Some(agitation_rad_s)),
    }
}
