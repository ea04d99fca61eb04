//! Where keys are in a file, to name the line of a mistake.

use std::collections::BTreeMap;

use errors::line_of;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Lines of keys, by their path: `factors.plant.mass_kg`, `fault.1.at_s`.
#[derive(Clone, Debug, Default)]
pub struct Lines(BTreeMap<String, usize>);

impl Lines {
    pub fn of(text: &str, document: &DeTable<'_>) -> Self {
        let mut lines = Self::default();
        lines.add_keys(text, "", document);
        lines
    }

    fn add_keys(&mut self, text: &str, before: &str, table: &DeTable<'_>) {
        for (key, value) in table {
            let path = format!("{before}{}", key.get_ref());
            self.add(text, path, key.span().start, value);
        }
    }

    fn add(&mut self, text: &str, path: String, start: usize, value: &Spanned<DeValue<'_>>) {
        let before = format!("{path}.");
        self.0.insert(path, line_of(text, start));
        match value.get_ref() {
            DeValue::Table(table) => self.add_keys(text, &before, table),
            DeValue::Array(items) => {
                let items = (1..).zip(items.iter());
                for (number, item) in items.filter(|(_, item)| item.get_ref().is_table()) {
                    self.add(text, format!("{before}{number}"), item.span().start, item);
                }
            }
            _ => {}
        }
    }

    /// Line of a key, or of the section that it is in; 1 where the file has neither.
    pub fn of_key(&self, path: &str) -> usize {
        let sections = std::iter::successors(Some(path), |path| Some(path.rsplit_once('.')?.0));
        let mut lines = sections.filter_map(|path| self.0.get(path));
        lines.next().copied().unwrap_or(1)
    }

    /// Line of the longest key of the settings, `section.key`, or the section that a message names; none where it names none.
    pub fn named_in(&self, message: &str) -> Option<usize> {
        // The same key may be below [factors] and [arms.NAME], too.
        let key = |path: &str| path.rmatch_indices('.').nth(1).map_or(0, |it| it.0 + 1);
        let keys = self.0.iter().map(|(path, line)| (&path[key(path)..], line));
        let is_named = |key: &str| {
            key.contains('.') && message.contains(key) || message.contains(&format!("[{key}]"))
        };
        let named = keys.filter(|(key, _)| is_named(key));
        let longest = named.max_by_key(|(key, _)| key.len());
        longest.map(|(_, line)| *line)
    }
}
