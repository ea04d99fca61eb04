//! Reads rows back, a column at a time.

use std::fs::File;
use std::path::{Path, PathBuf};

use errors::{Failure, InFile as _};
use parquet::file::reader::SerializedFileReader;

use crate::campaign::Campaign;
use crate::chunk::{Identity, metadata, path_of, write_whole};
use crate::parquet_file::{read_column, read_table, write_rows, writer};
use crate::table::{Cells, Table, Values};

/// The files of some chunks, in order. In them, the arms of a flight follow each other.
#[derive(Clone, Debug)]
pub struct Rows {
    files: Vec<PathBuf>,
}

/// Rows that a merged file has in one group, at least.
const GROUP: usize = 65_536;

impl Rows {
    /// Of chunks that were found to be whole.
    pub fn new(directory: &Path, chunks: impl IntoIterator<Item = u64>) -> Self {
        Self {
            files: chunks
                .into_iter()
                .map(|chunk| path_of(directory, chunk))
                .collect(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }

    /// Hands over a column, file by file.
    fn each(&self, column: &str, mut take: impl FnMut(Values)) -> Result<(), Failure> {
        for path in &self.files {
            take(read_column(path, column)?);
        }
        Ok(())
    }

    /// A column of numbers; NaN where there is none.
    pub fn numbers(&self, column: &str) -> Result<Vec<f64>, Failure> {
        let mut all = Vec::new();
        self.each(column, |values| match values {
            Values::Integers(values) => {
                all.extend(
                    values
                        .into_iter()
                        .map(|it| it.map_or(f64::NAN, |it| it as f64)),
                );
            }
            Values::Numbers(values) => {
                all.extend(values.into_iter().map(|it| it.unwrap_or(f64::NAN)));
            }
            _ => {}
        })?;
        Ok(all)
    }

    pub fn whole(&self, column: &str) -> Result<Vec<u64>, Failure> {
        let mut all = Vec::new();
        self.each(column, |values| {
            if let Values::Integers(values) = values {
                all.extend(values.into_iter().flatten().map(i64::cast_unsigned));
            }
        })?;
        Ok(all)
    }

    /// A column of what holds; none where it has no meaning.
    pub fn flags(&self, column: &str) -> Result<Vec<Option<bool>>, Failure> {
        let mut all = Vec::new();
        self.each(column, |values| {
            if let Values::Flags(values) = values {
                all.extend(values);
            }
        })?;
        Ok(all)
    }

    /// Whether each row has something in a column.
    pub fn filled(&self, column: &str) -> Result<Vec<bool>, Failure> {
        let mut all = Vec::new();
        self.each(column, |values| all.extend(values.filled()))?;
        Ok(all)
    }

    /// A column of words, as their places among the `most` that come first, and these; others are one more.
    pub fn words(&self, column: &str, most: usize) -> Result<(Vec<u32>, Vec<String>), Failure> {
        let (mut places, mut words) = (Vec::new(), Vec::<String>::new());
        self.each(column, |values| {
            let Values::Texts(values) = values else {
                return;
            };
            for word in values {
                let word = word.unwrap_or_default();
                let known = words.iter().position(|known| *known == word);
                let place = known.unwrap_or_else(|| {
                    if words.len() < most {
                        words.push(word.clone());
                    }
                    words.len() - usize::from(words.last().is_some_and(|last| *last == word))
                });
                places.push(place as u32);
            }
        })?;
        Ok((places, words))
    }

    /// The cells of a row as text, by the names of their columns; none where there is no such row.
    pub fn row(
        &self,
        campaign: &Campaign,
        flight: u64,
        arm: usize,
    ) -> Result<Option<Cells>, Failure> {
        let chunk = flight / campaign.chunk;
        let is_of =
            |path: &&PathBuf| **path == path_of(path.parent().unwrap_or(Path::new("")), chunk);
        let Some(path) = self.files.iter().find(is_of) else {
            return Ok(None);
        };
        let place = (flight % campaign.chunk) as usize * campaign.arms.len() + arm;
        let table = read(path, campaign)?;
        if place >= table.rows() {
            return Err(Failure::failed(format!(
                "{} ends after {} rows, and has fewer than its campaign",
                path.display(),
                table.rows()
            ))
            .help(
                "`ironbird campaign status` names what is broken, and `campaign run` flies it again",
            ));
        }
        Ok(Some(table.cells(place)))
    }

    /// Writes all rows into one file, whose content depends on nothing but the campaign.
    pub fn merge(
        &self,
        campaign: &Campaign,
        identity: &Identity,
        to: &Path,
    ) -> Result<u64, Failure> {
        let mut table = Table::new(campaign, &[]);
        let mut rows = 0;
        write_whole(to, |file| {
            let refused = |e: parquet::errors::ParquetError| Failure::failed(e.to_string());
            let says = metadata(identity, None, None);
            let mut writer = writer(file, &table, &says, None).map_err(refused)?;
            for (i, path) in self.files.iter().enumerate() {
                table.append(read(path, campaign)?);
                if table.rows() >= GROUP || i + 1 == self.files.len() {
                    rows += table.rows() as u64;
                    write_rows(&mut writer, &table).map_err(refused)?;
                    table = Table::new(campaign, &[]);
                }
            }
            writer.close().map(drop).map_err(refused)
        })?;
        Ok(rows)
    }
}

/// All rows of a file.
pub(crate) fn read(path: &Path, campaign: &Campaign) -> Result<Table, Failure> {
    let file = File::open(path).in_file("read", path)?;
    SerializedFileReader::new(file)
        .and_then(|reader| read_table(&reader, Table::new(campaign, &[])))
        .in_file("read", path)
}
