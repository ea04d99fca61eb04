//! Tables with a name for each row, as text, HTML or Markdown.

use crate::render::html;
use maud::{Markup, html as markup};

/// A table: the first column is the name of each row.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Table {
    /// Names of the columns after the first.
    pub columns: Vec<String>,
    pub rows: Vec<(String, Vec<String>)>,
}

impl Table {
    /// As text: names to the left, cells to the right of columns that are at least `least` characters wide.
    #[must_use]
    pub fn text(&self, least: usize) -> String {
        let length = |text: &String| text.chars().count();
        let names = self.rows.iter().map(|(name, _)| length(name));
        let name_width = names.max().unwrap_or(0);
        let width = |(i, column): (usize, &String)| {
            let cells = self.rows.iter().filter_map(|(_, cells)| cells.get(i));
            let widest = cells.chain([column]).map(length).max().unwrap_or(0);
            (widest + 3).max(least)
        };
        let widths: Vec<usize> = self.columns.iter().enumerate().map(width).collect();
        let line = |name: &str, cells: &[String]| {
            let cells = cells.iter().zip(&widths);
            let cells: String = cells
                .map(|(cell, width)| format!("{cell:>width$}"))
                .collect();
            format!("  {name:name_width$}{cells}\n")
        };
        let rows = self.rows.iter().map(|(name, cells)| line(name, cells));
        std::iter::once(line("", &self.columns))
            .chain(rows)
            .collect()
    }

    /// As HTML; `name` is the name of the first column.
    #[must_use]
    pub fn html(&self, name: &str) -> Markup {
        let columns: Vec<&str> = std::iter::once(name)
            .chain(self.columns.iter().map(String::as_str))
            .collect();
        let rows = self
            .rows
            .iter()
            .map(|(name, cells)| std::iter::once(name).chain(cells).map(html::cell).collect());
        html::table(&columns, rows)
    }

    /// As Markdown; `name` is the name of the first column.
    #[must_use]
    pub fn markdown(&self, name: &str) -> String {
        let line = |name: &str, cells: &[String]| {
            let cells: Vec<&str> = std::iter::once(name)
                .chain(cells.iter().map(String::as_str))
                .collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let rows: String = self
            .rows
            .iter()
            .map(|(name, cells)| line(name, cells))
            .collect();
        let rule = "---|".repeat(self.columns.len() + 1);
        format!("{}|{rule}\n{rows}", line(name, &self.columns))
    }
}

/// A part of a result: a title, an explanation where it needs one, and a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Identifier of its section on a page.
    pub id: &'static str,
    pub title: String,
    /// A sentence; empty where the title says enough.
    pub note: String,
    pub table: Table,
}

impl Part {
    /// As text; nothing for a table without columns.
    #[must_use]
    pub fn text(&self, least: usize) -> String {
        if self.table.columns.is_empty() {
            return String::new();
        }
        let note = if self.note.is_empty() {
            String::new()
        } else {
            format!("{}\n", self.note)
        };
        format!("\n{}\n{note}{}", self.title, self.table.text(least))
    }

    /// As a section of a page; `name` is the name of the first column.
    #[must_use]
    pub fn html(&self, name: &str) -> Markup {
        let content = markup! {
            @if !self.note.is_empty() { p { (self.note) } }
            (self.table.html(name))
        };
        html::section(self.id, &self.title, content)
    }
}
