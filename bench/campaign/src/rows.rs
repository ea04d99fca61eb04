//! Reads rows back, a column at a time.

use std::fs::File;
use std::path::{Path, PathBuf};

use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float64Type, Int64Type};
use arrow_array::{Array as _, ArrayRef, RecordBatch};
use arrow_schema::DataType;
use failure::{Failure, InFile as _};
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder};

use crate::campaign::Campaign;
use crate::chunk::{Identity, path_of, told, write_whole, writer};
use crate::table::{Columns, Row};

/// The files of some chunks, in order. In them, the arms of a flight follow each other.
#[derive(Clone, Debug)]
pub struct Rows {
    files: Vec<PathBuf>,
}

/// A row as text, by the names of its columns.
pub type Cells = Vec<(String, String)>;

/// Rows that are decoded at once.
const BATCH: usize = 8192;

impl Rows {
    /// Of chunks that were found to be whole.
    #[must_use]
    pub fn new(directory: &Path, chunks: impl IntoIterator<Item = u64>) -> Self {
        Self { files: chunks.into_iter().map(|chunk| path_of(directory, chunk)).collect() }
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }

    /// Hands over the arrays of a column.
    fn each(&self, column: &str, mut take: impl FnMut(&ArrayRef)) -> Result<(), Failure> {
        for path in &self.files {
            for batch in open(path, Some(column))? {
                take(batch.in_file("read", path)?.column(0));
            }
        }
        Ok(())
    }

    /// A column of numbers; NaN where there is none.
    ///
    /// # Errors
    /// [`Failure`] names the file that cannot be read.
    pub fn numbers(&self, column: &str) -> Result<Vec<f64>, Failure> {
        let mut all = Vec::new();
        self.each(column, |array| match array.data_type() {
            DataType::Int64 => {
                all.extend(array.as_primitive::<Int64Type>().iter().map(|it| it.map_or(f64::NAN, |it| it as f64)))
            }
            DataType::Float64 => {
                all.extend(array.as_primitive::<Float64Type>().iter().map(|it| it.unwrap_or(f64::NAN)))
            }
            _ => {}
        })?;
        Ok(all)
    }

    /// A column of whole numbers.
    ///
    /// # Errors
    /// As [`Self::numbers`].
    pub fn whole(&self, column: &str) -> Result<Vec<u64>, Failure> {
        let mut all = Vec::new();
        self.each(column, |array| {
            let numbers = array.as_primitive_opt::<Int64Type>();
            all.extend(numbers.into_iter().flat_map(|it| it.values().iter().map(|it| it.cast_unsigned())));
        })?;
        Ok(all)
    }

    /// A column of what holds; none where it has no meaning.
    ///
    /// # Errors
    /// As [`Self::numbers`].
    pub fn flags(&self, column: &str) -> Result<Vec<Option<bool>>, Failure> {
        let mut all = Vec::new();
        self.each(column, |array| all.extend(array.as_boolean_opt().into_iter().flat_map(|it| it.iter())))?;
        Ok(all)
    }

    /// Whether each row has something in a column.
    ///
    /// # Errors
    /// As [`Self::numbers`].
    pub fn filled(&self, column: &str) -> Result<Vec<bool>, Failure> {
        let mut all = Vec::new();
        self.each(column, |array| all.extend((0..array.len()).map(|row| array.is_valid(row))))?;
        Ok(all)
    }

    /// A column of words, as their places among the `most` that come first, and these; others are one more.
    ///
    /// # Errors
    /// As [`Self::numbers`].
    pub fn words(&self, column: &str, most: usize) -> Result<(Vec<u32>, Vec<String>), Failure> {
        let (mut places, mut words) = (Vec::new(), Vec::<String>::new());
        self.each(column, |array| {
            for word in array.as_string_opt::<i32>().into_iter().flat_map(|it| it.iter()) {
                let word = word.unwrap_or_default();
                let known = words.iter().position(|known| known == word);
                let place = known.unwrap_or_else(|| {
                    if words.len() < most {
                        words.push(word.to_owned());
                    }
                    words.len() - usize::from(words.last().is_some_and(|last| last == word))
                });
                places.push(place as u32);
            }
        })?;
        Ok((places, words))
    }

    /// The cells of a row as text, by the names of their columns; none where there is no such row.
    ///
    /// # Errors
    /// As [`Self::numbers`].
    pub fn row(&self, campaign: &Campaign, flight: u64, arm: usize) -> Result<Option<Cells>, Failure> {
        let chunk = flight / campaign.chunk;
        let is_of = |path: &&PathBuf| **path == path_of(path.parent().unwrap_or(Path::new("")), chunk);
        let Some(path) = self.files.iter().find(is_of) else { return Ok(None) };
        let place = (flight % campaign.chunk) as usize * campaign.arms.len() + arm;
        Ok(cells_in(path, &[place])?.pop())
    }

    /// Writes all rows into one file, whose content depends on nothing but the campaign.
    ///
    /// # Errors
    /// [`Failure`] names the file.
    pub fn merge(&self, campaign: &Campaign, identity: &Identity, to: &Path) -> Result<u64, Failure> {
        let like = RecordBatch::new_empty(Columns::new(campaign).schema());
        let mut rows = 0;
        write_whole(to, |file| {
            let refused = |e: parquet::errors::ParquetError| Failure::failed(e.to_string());
            let mut writer = writer(file, &like, told(identity, None, None)).map_err(refused)?;
            for path in &self.files {
                for batch in open(path, None)? {
                    let columns = batch.in_file("read", path)?.columns().to_vec();
                    let batch = RecordBatch::try_new(like.schema(), columns).in_file("read", path)?;
                    rows += batch.num_rows() as u64;
                    writer.write(&batch).map_err(refused)?;
                }
            }
            writer.close().map(drop).map_err(refused)
        })?;
        Ok(rows)
    }
}

/// The cells of rows of a chunk as text, in the order of their places, which rise.
///
/// # Errors
/// [`Failure`] names the file that cannot be read.
pub fn cells_of(directory: &Path, chunk: u64, places: &[usize]) -> Result<Vec<Cells>, Failure> {
    cells_in(&path_of(directory, chunk), places)
}

fn cells_in(path: &Path, places: &[usize]) -> Result<Vec<Cells>, Failure> {
    let (mut all, mut before) = (Vec::with_capacity(places.len()), 0);
    for batch in open(path, None)? {
        let batch = batch.in_file("read", path)?;
        let here = places[all.len()..].iter().take_while(|place| **place < before + batch.num_rows());
        all.extend(here.map(|place| cells(&batch, place - before)).collect::<Vec<_>>());
        before += batch.num_rows();
    }
    if all.len() < places.len() {
        return Err(Failure::failed(format!(
            "{} ends after {before} rows, and has fewer than its campaign",
            path.display()
        ))
        .help("`ironbird campaign status` names what is broken, and `campaign run` flies it again"));
    }
    Ok(all)
}

/// The cells of rows that are in no file.
///
/// # Errors
/// As [`Columns::batch`].
pub fn cells_again(campaign: &Campaign, rows: &[Row]) -> Result<Vec<Cells>, Failure> {
    let batch = Columns::new(campaign).batch(campaign, rows)?;
    Ok((0..rows.len()).map(|row| cells(&batch, row)).collect())
}

/// The batches of a file: of one column, or of all.
fn open(path: &Path, column: Option<&str>) -> Result<ParquetRecordBatchReader, Failure> {
    let file = File::open(path).in_file("read", path)?;
    let builder = ParquetRecordBatchReaderBuilder::try_new(file).in_file("read", path)?;
    let place = column.map(|column| builder.schema().index_of(column)).transpose().in_file("read", path)?;
    let mask = place.map_or_else(ProjectionMask::all, |place| ProjectionMask::roots(builder.parquet_schema(), [place]));
    builder.with_projection(mask).with_batch_size(BATCH).build().in_file("read", path)
}

/// A row as text.
fn cells(batch: &RecordBatch, row: usize) -> Cells {
    let text = |column: &ArrayRef| {
        if column.is_null(row) {
            return String::new();
        }
        match column.data_type() {
            DataType::Int64 => column.as_primitive::<Int64Type>().value(row).to_string(),
            DataType::Float64 => column.as_primitive::<Float64Type>().value(row).to_string(),
            DataType::Boolean => column.as_boolean().value(row).to_string(),
            _ => column.as_string_opt::<i32>().map_or_else(String::new, |it| it.value(row).to_owned()),
        }
    };
    let names = batch.schema();
    names.fields().iter().zip(batch.columns()).map(|(field, column)| (field.name().clone(), text(column))).collect()
}
