//! Reads rows back, a column at a time.

use std::fs::File;
use std::path::{Path, PathBuf};

use errors::{Failure, InFile as _};
use parquet::file::reader::SerializedFileReader;

use crate::campaign::Campaign;
use crate::chunk::{Identity, metadata, path_of, write_whole};
use crate::parquet_file::{read_column, read_table, write_rows, writer};
use crate::table::{Cell, Table, TextRow};

/// The files of some chunks, in order. In them, the arms of a flight follow each other.
#[derive(Clone, Debug)]
pub struct Rows {
    files: Vec<PathBuf>,
}

/// Rows that a merged file has in one group, at least.
const GROUP: usize = 65_536;

impl Rows {
    pub fn new(directory: &Path, chunks: impl IntoIterator<Item = u64>) -> Self {
        let chunks = chunks.into_iter();
        Self {
            files: chunks.map(|chunk| path_of(directory, chunk)).collect(),
        }
    }

    fn column<T>(
        &self,
        column: &str,
        value: impl Fn(Option<Cell>) -> T,
    ) -> Result<Vec<T>, Failure> {
        let mut all = Vec::new();
        for path in &self.files {
            all.extend(read_column(path, column)?.into_iter().map(&value));
        }
        Ok(all)
    }

    pub fn numbers(&self, column: &str) -> Result<Vec<f64>, Failure> {
        self.column(column, |cell| match cell {
            Some(Cell::Number(number)) => number,
            Some(Cell::Integer(integer)) => integer as f64,
            _ => f64::NAN,
        })
    }

    pub fn flights(&self) -> Result<Vec<u64>, Failure> {
        self.column("flight", |cell| match cell {
            Some(Cell::Integer(flight)) => flight.cast_unsigned(),
            _ => 0,
        })
    }

    pub fn flags(&self, column: &str) -> Result<Vec<Option<bool>>, Failure> {
        self.column(column, |cell| match cell {
            Some(Cell::Flag(flag)) => Some(flag),
            _ => None,
        })
    }

    pub fn filled(&self, column: &str) -> Result<Vec<bool>, Failure> {
        self.column(column, |cell| cell.is_some())
    }

    /// A column of words, as their places among the `most` that come first, and these; others are one more.
    pub fn words(&self, column: &str, most: usize) -> Result<(Vec<u32>, Vec<String>), Failure> {
        let mut words = Vec::<String>::new();
        let mut places = Vec::new();
        let all = self.column(column, |cell| cell.map(|cell| cell.to_string()))?;
        for word in all.into_iter().map(Option::unwrap_or_default) {
            let known = words.iter().position(|known| *known == word);
            let place = known.unwrap_or(words.len());
            if known.is_none() && words.len() < most {
                words.push(word);
            }
            places.push(place as u32);
        }
        Ok((places, words))
    }

    pub fn row(
        &self,
        campaign: &Campaign,
        flight: u64,
        arm: usize,
    ) -> Result<Option<TextRow>, Failure> {
        let name = path_of(Path::new(""), flight / campaign.chunk);
        let Some(path) = self.files.iter().find(|path| path.ends_with(&name)) else {
            return Ok(None);
        };
        let place = (flight % campaign.chunk) as usize * campaign.arms.len() + arm;
        let table = read(path, campaign)?;
        if place < table.rows() {
            return Ok(Some(table.text_row(place)));
        }
        let (path, rows) = (path.display(), table.rows());
        Err(Failure::failed(format!(
            "{path} ends after {rows} rows, and has fewer than its campaign"
        ))
        .help("`ironbird campaign status` names what is broken, and `campaign run` flies it again"))
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

pub(crate) fn read(path: &Path, campaign: &Campaign) -> Result<Table, Failure> {
    let file = File::open(path).in_file("read", path)?;
    SerializedFileReader::new(file)
        .and_then(|reader| read_table(&reader, Table::new(campaign, &[])))
        .in_file("read", path)
}
