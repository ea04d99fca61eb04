//! Where in a file keys are, to name the line of a mistake.

use std::collections::BTreeMap;
use std::ops::Range;

use toml_edit::{Document, Item, Key, TableLike};

/// Lines of keys, by their path: `factors.plant.mass_kg`, `fault.1.at_s`.
#[derive(Clone, Debug, Default)]
pub struct Lines(BTreeMap<String, usize>);

impl Lines {
    pub fn of(text: &str) -> Self {
        let mut lines = Self::default();
        if let Ok(document) = Document::parse(text) {
            lines.take(text, "", document.as_table());
        }
        lines
    }

    fn take(&mut self, text: &str, path: &str, table: &dyn TableLike) {
        for (name, item) in table.iter() {
            let path = format!("{path}.{name}");
            let path = path.trim_start_matches('.').to_owned();
            let span = table.key(name).and_then(Key::span).or_else(|| item.span());
            if let Some(span) = span {
                self.0.insert(path.clone(), line_of(text, &span));
            }
            match item {
                Item::ArrayOfTables(tables) => {
                    for (i, table) in tables.iter().enumerate() {
                        let path = format!("{path}.{}", i + 1);
                        table.span().into_iter().for_each(|span| {
                            self.0.insert(path.clone(), line_of(text, &span));
                        });
                        self.take(text, &path, table);
                    }
                }
                item => item
                    .as_table_like()
                    .into_iter()
                    .for_each(|table| self.take(text, &path, table)),
            }
        }
    }

    /// Line of a key, or of what it is in; 1 where nothing of it is there.
    pub fn of_key(&self, path: &str) -> usize {
        let mut path = path;
        loop {
            if let Some(line) = self.0.get(path) {
                return *line;
            }
            match path.rsplit_once('.') {
                Some((outer, _)) => path = outer,
                None => return 1,
            }
        }
    }

    /// Line of the longest key of the settings, `section.key`, that a text speaks of; none where it speaks of none.
    pub fn spoken_of(&self, said: &str) -> Option<usize> {
        // The same key stands below [factors] and [arms.NAME], too.
        let key = |path: &str| path.rmatch_indices('.').nth(1).map_or(0, |it| it.0 + 1);
        let keys = self.0.iter().map(|(path, line)| (&path[key(path)..], line));
        let spoken = keys.filter(|(key, _)| key.contains('.') && said.contains(key));
        let longest = spoken.max_by_key(|(key, _)| key.len());
        longest.map(|(_, line)| *line)
    }
}

pub(crate) fn line_of(text: &str, span: &Range<usize>) -> usize {
    let before = &text.as_bytes()[..span.start.min(text.len())];
    1 + before.iter().filter(|byte| **byte == b'\n').count()
}
