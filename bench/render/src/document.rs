//! A result as a document: built once, written as terminal text, as a web page or as Markdown.
//!
//! A terminal shows neither charts nor what a page folds away. A page is self-contained: no network, no font; its scripts
//! read charts out, zoom them, and move the vehicle.

use crate::plot::{Chart, STYLE};
use comfy_table::{CellAlignment, ContentArrangement, presets};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use std::fmt::Display;

const PAGE_STYLE: &str = include_str!("page.css");
/// Reads a chart out where a pointer is, and zooms charts over time.
const READOUT: &str = include_str!("readout.js");
/// Moves the vehicle of an overview.
const REPLAY: &str = include_str!("replay.js");
/// The page may load nothing, wherever the words in it come from.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; base-uri 'none'";

#[derive(Clone, Debug, Default)]
pub struct Document {
    pub title: String,
    pub heading: String,
    /// Beside the heading: a word, and whether it is bad news.
    pub verdict: Option<(String, bool)>,
    pub build: String,
    pub lead: Vec<Block>,
    pub sections: Vec<Section>,
    pub footer: String,
    /// Whether charts mark missed deadlines, which can be switched off.
    pub has_miss_lines: bool,
}

#[derive(Clone, Debug)]
pub struct Section {
    pub id: &'static str,
    pub title: String,
    pub blocks: Vec<Block>,
    /// Whether a page shows its title alone until it is opened.
    pub is_folded: bool,
}

#[derive(Clone, Debug)]
pub enum Block {
    Fact(&'static str, String),
    Paragraph(String),
    Warning(String),
    Items(Vec<String>),
    /// What a page shows as a figure.
    Terminal(String),
    Heading(String),
    Table(Table),
    /// Subject, verdict, reason, and whether it is good, bad or open.
    Verdicts([(&'static str, String, String, &'static str); 3]),
    /// Title, value and unit of the most important numbers; on a page only, as the next ones.
    KeyFigures(Vec<(&'static str, String, String)>),
    /// Commands, each with what it shows.
    NextSteps(Vec<(String, &'static str)>),
    /// A flight in three dimensions, as JSON for replay.js, beside charts.
    Overview(String, Vec<Figure>),
    /// A title, and what happened: when, what kind of thing, and what.
    Events(String, Vec<[String; 3]>),
    Note(String),
    PageHeading(&'static str),
    Legend(Vec<(&'static str, String)>),
    Figures(Vec<Figure>),
    WideFigures(Vec<Figure>),
    Details(String, Vec<Block>),
}

#[derive(Clone, Debug)]
pub struct Figure {
    pub name: String,
    pub title: String,
    pub keys: Vec<(&'static str, String)>,
    pub note: String,
    pub chart: Chart,
}

/// A table; the first column is the name of each row.
#[derive(Clone, Debug, Default)]
pub struct Table {
    pub columns: Vec<String>,
    pub rows: Vec<Vec<Cell>>,
}

#[derive(Clone, Debug, Default)]
pub struct Cell {
    pub text: String,
    pub class: &'static str,
    /// How dark it is on a page [%].
    pub shade: Option<f64>,
}

impl<T: Display> From<T> for Cell {
    fn from(value: T) -> Self {
        Self {
            text: value.to_string(),
            ..Self::default()
        }
    }
}

impl Cell {
    pub fn colored(text: impl Display, class: &'static str) -> Self {
        Self {
            class,
            ..text.into()
        }
    }
}

/// The title of a column, and the cell of a row in it.
pub type Column<T> = (&'static str, fn(&T) -> String);

pub fn row<const N: usize>(cells: [&dyn Display; N]) -> Vec<Cell> {
    cells.map(Cell::from).into()
}

pub fn table(
    columns: impl IntoIterator<Item = impl Into<String>>,
    rows: impl IntoIterator<Item = Vec<Cell>>,
) -> Block {
    Block::Table(Table::new(columns, rows))
}

/// A number, or a dash where there is none.
pub fn known<T: Display>(value: Option<T>) -> String {
    value.map_or_else(|| "-".into(), |value| value.to_string())
}

pub fn us(value: f64) -> String {
    format!("{value:.1}")
}

impl Document {
    pub fn text(&self) -> String {
        let sections = self.sections.iter().filter_map(|section| {
            let text = text(&section.blocks);
            let is_for_pages = text.is_empty() && !section.blocks.is_empty();
            (!is_for_pages).then(|| format!("\n{}\n{text}", section.title))
        });
        std::iter::once(text(&self.lead)).chain(sections).collect()
    }

    pub fn html(&self) -> String {
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta http-equiv="Content-Security-Policy" content=(POLICY);
                    meta name="generator" content=(format!("ironbird {}", self.build));
                    // An empty picture, so that no browser asks a server for one.
                    link rel="icon" href="data:,";
                    title { (self.title) }
                    style { (PreEscaped(STYLE)) (PreEscaped(PAGE_STYLE)) }
                }
                body {
                    header {
                        h1 {
                            (self.heading) " "
                            @if let Some((verdict, is_bad)) = &self.verdict { span.verdict.bad[*is_bad] { (verdict) } }
                        }
                        @for block in &self.lead { (block.html()) }
                    }
                    nav {
                        @for section in &self.sections { a href=(format!("#{}", section.id)) { (section.id) } }
                        @if self.has_miss_lines {
                            label { input #miss-lines type="checkbox" checked; "missed deadlines in charts" }
                        }
                    }
                    main {
                        @for section in &self.sections {
                            section id=(section.id) { (section.html()) }
                        }
                    }
                    footer { "ironbird " (self.build) (self.footer) }
                    script { (PreEscaped(READOUT)) }
                    @if self.lead.iter().any(|block| matches!(block, Block::Overview(..))) {
                        script { (PreEscaped(crate::VEHICLE_JS)) (PreEscaped(REPLAY)) }
                    }
                }
            }
        };
        page.into_string()
    }
}

impl Section {
    pub fn new(id: &'static str, title: impl Into<String>, blocks: Vec<Block>) -> Self {
        Self {
            id,
            title: title.into(),
            blocks,
            is_folded: false,
        }
    }

    fn html(&self) -> Markup {
        html! {
            @if self.is_folded {
                details { summary { h2 { (self.title) } } @for block in &self.blocks { (block.html()) } }
            } @else {
                h2 { (self.title) }
                @for block in &self.blocks { (block.html()) }
            }
        }
    }
}

pub fn text(blocks: &[Block]) -> String {
    blocks.iter().map(Block::text).collect()
}

impl Block {
    fn text(&self) -> String {
        match self {
            Self::Fact(subject, said) => format!("{subject:<9} {said}\n"),
            Self::Paragraph(line) | Self::Warning(line) | Self::Heading(line) => {
                format!("{line}\n")
            }
            Self::Items(items) => items.iter().map(|item| format!("  {item}\n")).collect(),
            Self::Terminal(text) => text.clone(),
            Self::Table(table) => table.text(),
            Self::Verdicts(verdicts) => {
                let lines = verdicts.iter().map(|(subject, verdict, why, _)| {
                    format!("{subject:<9} {verdict:<14} {why}\n")
                });
                lines.collect()
            }
            _ => String::new(),
        }
    }

    fn html(&self) -> Markup {
        match self {
            Self::Fact(subject, said) => html! { p { (subject) ": " (said) } },
            Self::Paragraph(line) => html! { p { (line) } },
            Self::Warning(line) => html! { p.bad { (line) } },
            Self::Items(items) => html! { ul { @for item in items { li { (item) } } } },
            Self::Terminal(_) => html! {},
            Self::Heading(title) => html! { h3 { (title) } },
            Self::Table(table) => table.html(),
            Self::Verdicts(verdicts) => html! {
                dl.words {
                    @for (subject, word, why, tone) in verdicts {
                        div.(tone) { dt { (subject) } dd.word { (word) } dd.why { (why) } }
                    }
                }
            },
            Self::KeyFigures(figures) => html! {
                dl.tiles {
                    @for (title, value, unit) in figures {
                        div { dt { (title) } dd { (value) " " span.unit { (unit) } } }
                    }
                }
            },
            Self::NextSteps(steps) => html! {
                dl.next {
                    dt { "Next" }
                    @for (command, shows) in steps { dd { code { (command) } " " (shows) } }
                }
            },
            Self::Overview(replay, figures) => html! {
                div.overview {
                    figure.replay {
                        figcaption {
                            b { "Path" }
                            span.key.flown { "flown" } " " span.key.reference { "reference" }
                        }
                        canvas aria-label="The vehicle and its path in three dimensions: arrow keys turn the view, + and - zoom, 0 resets it" {}
                        div.controls {
                            button type="button" { "Play" }
                            input type="range" min="0" step="any" aria-label="time of the flight";
                            output {}
                        }
                        script.flight type="application/json" { (PreEscaped(replay)) }
                    }
                    div { @for figure in figures { (figure.html()) } }
                }
            },
            Self::Events(title, events) => html! {
                h3 { (title) }
                ol.events {
                    @for [when, kind, what] in events { li { time { (when) } b.(kind) { (kind) } span { (what) } } }
                }
            },
            Self::Note(line) => html! { p.note { (line) } },
            Self::PageHeading(title) => html! { h3 { (title) } },
            Self::Legend(entries) => html! {
                p.marks { @for (class, word) in entries { span.key.(class) { (word) } " " } }
            },
            Self::Figures(figures) => {
                html! { div.plots { @for figure in figures { (figure.html()) } } }
            }
            Self::WideFigures(figures) => {
                html! { div.plots.wide { @for figure in figures { (figure.html()) } } }
            }
            Self::Details(summary, blocks) => html! {
                details { summary { (summary) } @for block in blocks { (block.html()) } }
            },
        }
    }
}

impl Figure {
    pub fn new(
        name: impl Into<String>,
        title: impl Into<String>,
        keys: Vec<(&'static str, String)>,
        chart: Chart,
    ) -> Self {
        Self {
            name: name.into(),
            title: title.into(),
            keys,
            note: String::new(),
            chart,
        }
    }

    fn html(&self) -> Markup {
        html! {
            figure data-plot=(self.name) {
                figcaption {
                    b { (self.title) }
                    @for (class, word) in &self.keys { " " span.key.(class) { (word) } }
                }
                @if !self.note.is_empty() { p.evidence { (self.note) } }
                (self.chart.svg(None))
            }
        }
    }
}

impl Table {
    pub fn new(
        columns: impl IntoIterator<Item = impl Into<String>>,
        rows: impl IntoIterator<Item = Vec<Cell>>,
    ) -> Self {
        Self {
            columns: columns.into_iter().map(Into::into).collect(),
            rows: rows.into_iter().collect(),
        }
    }

    /// A row per item, with a cell from each column's function.
    pub fn of<'a, T: 'a>(columns: &[Column<T>], items: impl IntoIterator<Item = &'a T>) -> Self {
        let row = |item: &T| columns.iter().map(|(_, cell)| cell(item).into()).collect();
        let titles = columns.iter().map(|(title, _)| *title);
        Self::new(titles, items.into_iter().map(row))
    }

    /// With the names of the rows indented below that of their column, and columns of numbers to the right.
    pub fn text(&self) -> String {
        self.aligned("  ", u16::MAX)
    }

    /// The same without an indent: a table that is all that is printed.
    pub fn list(&self) -> String {
        self.aligned("", u16::MAX)
    }

    /// A list whose long cells are wrapped, so that no line is longer than `width`.
    pub fn list_within(&self, width: u16) -> String {
        self.aligned("", width)
    }

    fn aligned(&self, indent: &str, width: u16) -> String {
        let mut table = comfy_table::Table::new();
        table.set_content_arrangement(ContentArrangement::Dynamic);
        table.set_width(width);
        table.load_style(presets::NOTHING);
        if self.columns.iter().any(|column| !column.is_empty()) {
            table.set_header(&self.columns);
        }
        for row in &self.rows {
            let indents = std::iter::once(indent)
                .chain(std::iter::repeat(""))
                .zip(row);
            table.add_row(indents.map(|(indent, cell)| format!("{indent}{}", cell.text)));
        }
        for (i, column) in table.column_iter_mut().enumerate() {
            column.set_padding((0, 2));
            if i > 0 && self.is_of_numbers(i) {
                column.set_cell_alignment(CellAlignment::Right);
            }
        }
        table.trim_fmt() + "\n"
    }

    fn is_of_numbers(&self, column: usize) -> bool {
        let mut cells = self.rows.iter().filter_map(|row| row.get(column));
        let is_numeric = |c: char| c.is_ascii_digit() || "+-><(".contains(c);
        cells.all(|cell| cell.text.is_empty() || cell.text.starts_with(is_numeric))
    }

    /// A table that becomes a list of cards where it is too wide: each cell carries its column's name.
    fn html(&self) -> Markup {
        let style = |cell: &Cell| {
            let shade = cell.shade?;
            Some(format!(
                "min-width:0;background:rgb(213 94 0 / {shade:.0}%)"
            ))
        };
        html! {
            // About as wide as it needs to be.
            table style=(format!("max-width:{}px", 150 * (self.columns.len() + 1))) {
                thead { tr { @for column in &self.columns { th { (column) } } } }
                tbody {
                    @for row in &self.rows {
                        tr {
                            @for (cell, column) in row.iter().zip(&self.columns).take(1) {
                                th scope="row" title=(column) { (cell.html()) }
                            }
                            @for (cell, column) in row.iter().zip(&self.columns).skip(1) {
                                td data-column=(column) style=[style(cell)] { (cell.html()) }
                            }
                        }
                    }
                }
            }
        }
    }

    pub fn markdown(&self) -> String {
        let line = |cells: Vec<&str>| format!("| {} |\n", cells.join(" | "));
        let head = line(self.columns.iter().map(String::as_str).collect());
        let rule = "---|".repeat(self.columns.len());
        let cells = |row: &Vec<Cell>| line(row.iter().map(|cell| cell.text.as_str()).collect());
        let rows: String = self.rows.iter().map(cells).collect();
        format!("{head}|{rule}\n{rows}")
    }
}

impl Cell {
    fn html(&self) -> Markup {
        html! { @if self.class.is_empty() { (self.text) } @else { span.(self.class) { (self.text) } } }
    }
}
