//! HTML elements that all pages use: figures with keys, tables, numbers.

pub use crate::phrase::count;
use crate::render::plot::Chart;
use maud::{Markup, html};

/// An entry of a figure's key: colour and word.
pub type Key<'a> = (&'a str, &'a str);

/// A picture with its name and key; `name` tells it from the others.
pub fn figure(name: &str, title: &str, keys: &[Key<'_>], picture: Markup) -> Markup {
    html! {
        figure data-plot=(name) {
            figcaption {
                b { (title) }
                @for (class, word) in keys { " " span.key.(class) { (word) } }
            }
            (picture)
        }
    }
}

pub fn chart(name: &str, title: &str, keys: &[Key<'_>], chart: &Chart) -> Markup {
    figure(name, title, keys, chart.svg(None))
}

/// A section with its name in the table of contents.
pub fn section(id: &str, title: &str, content: Markup) -> Markup {
    html! { section id=(id) { h2 { (title) } (content) } }
}

/// A table that becomes a list of cards where it is too wide: each cell carries its column's name. The first column is
/// the row's name.
pub fn table(columns: &[&str], rows: impl IntoIterator<Item = Vec<Markup>>) -> Markup {
    html! {
        // About as wide as it needs to be.
        table style=(format!("max-width:{}px", 150 * (columns.len() + 1))) {
            thead { tr { @for column in columns { th { (column) } } } }
            tbody {
                @for row in rows {
                    tr {
                        @for (i, cell) in row.into_iter().enumerate() {
                            @let column = columns.get(i).copied().unwrap_or_default();
                            @if i == 0 { th scope="row" { (cell) } } @else { td data-column=(column) { (cell) } }
                        }
                    }
                }
            }
        }
    }
}

pub fn cell(text: impl std::fmt::Display) -> Markup {
    html! { (text.to_string()) }
}

pub fn us(value: f64) -> String {
    format!("{value:.1}")
}

/// The same where there are enough values for it.
pub fn us_if_known(value: Option<f64>) -> String {
    value.map_or_else(|| "-".into(), us)
}

/// A number of any size in four digits.
pub fn number(value: f64) -> String {
    if value == 0.0 || (1e-2..1e5).contains(&value.abs()) {
        format!("{value:.4}")
    } else {
        format!("{value:.3e}")
    }
}
