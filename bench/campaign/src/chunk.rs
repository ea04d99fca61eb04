//! Files of rows: the flights of one chunk, whole or absent.

use std::fs::{self, File};
use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_array::cast::AsArray as _;
use arrow_array::types::Int64Type;
use failure::{Failure, InFile as _};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;

use crate::campaign::Campaign;
use crate::generator::Stream;
use crate::sum::sum_of;
use crate::table::{Columns, Row};

/// Identifies the form of files of rows.
pub const SCHEMA: &str = "ironbird-campaign/1";
/// Level of compression: higher ones take longer than they save.
const LEVEL: i32 = 3;

/// What the files of a campaign say of themselves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Name of the campaign.
    pub name: String,
    /// [`Campaign::fingerprint`].
    pub campaign: String,
    /// The build that flew: rows of another one may have other bits.
    pub build: String,
}

/// What a file of rows is found to be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// Not there.
    Missing,
    /// All of its rows are there.
    Whole,
    /// It cannot be used, and why.
    Refused(String),
}

impl Campaign {
    /// How many files of rows it has.
    #[must_use]
    pub const fn chunks(&self) -> u64 {
        self.flights.div_ceil(self.chunk)
    }

    /// The flights of a chunk.
    #[must_use]
    pub fn flights_of(&self, chunk: u64) -> Range<u64> {
        let first = chunk * self.chunk;
        first..(first + self.chunk).min(self.flights)
    }

    /// The flights of a chunk that are in an audit of a share of all: always the same ones, and of a larger share these
    /// and more.
    pub fn audited(&self, chunk: u64, share: f64) -> impl Iterator<Item = u64> {
        let stream = Stream::new(self.seed, "audit");
        self.flights_of(chunk).filter(move |flight| stream.units(*flight, 0)[0] < share)
    }

    /// The chunks of a shard, of which there are `of`, numbered from 1.
    #[must_use]
    pub fn shard(&self, number: u64, of: u64) -> Range<u64> {
        let cut = |shard: u64| (u128::from(self.chunks()) * u128::from(shard) / u128::from(of)) as u64;
        cut(number - 1)..cut(number)
    }
}

/// The file of a chunk.
#[must_use]
pub fn path_of(directory: &Path, chunk: u64) -> PathBuf {
    directory.join(format!("chunk-{chunk:07}.parquet"))
}

/// Writes the rows of a chunk aside, and gives the file its name when it is whole and on the disk.
///
/// # Errors
/// [`Failure`] names the file.
pub fn write(
    directory: &Path,
    campaign: &Campaign,
    identity: &Identity,
    chunk: u64,
    rows: &[Row],
) -> Result<(), Failure> {
    let path = path_of(directory, chunk);
    let batch = Columns::new(campaign).batch(campaign, rows)?;
    let told = told(identity, Some((chunk, campaign.flights_of(chunk))), Some(&batch));
    write_whole(&path, |file| {
        let mut writer = writer(file, &batch, told)?;
        writer.write(&batch)?;
        writer.close().map(drop)
    })
}

/// Writes a file aside under a name of this process, and renames it when it is whole and on the disk.
///
/// # Errors
/// [`Failure`] names the file.
pub fn write_whole<E: std::fmt::Display>(
    path: &Path,
    write: impl FnOnce(&mut File) -> Result<(), E>,
) -> Result<(), Failure> {
    let aside = path.with_extension(format!("{}.aside", std::process::id()));
    let written = File::create(&aside).in_file("write", &aside).and_then(|mut file| {
        write(&mut file).in_file("write", &aside)?;
        file.flush().and_then(|()| file.sync_all()).in_file("write", &aside)
    });
    written.and_then(|()| fs::rename(&aside, path).in_file("write", path)).inspect_err(|_| {
        // What is left of it is nobody's.
        let _ = fs::remove_file(&aside);
    })
}

/// Bytes that a file of rows would take.
///
/// # Errors
/// [`Failure`] where they cannot be written.
pub fn length(campaign: &Campaign, identity: &Identity, rows: &[Row]) -> Result<usize, Failure> {
    let batch = Columns::new(campaign).batch(campaign, rows)?;
    let mut bytes = Vec::new();
    let written = writer(&mut bytes, &batch, told(identity, None, Some(&batch))).and_then(|mut writer| {
        writer.write(&batch)?;
        writer.close()
    });
    written.map_err(|e| Failure::failed(format!("rows of flights: {e}")))?;
    Ok(bytes.len())
}

/// A writer of rows like these, with what the file says of itself.
///
/// # Errors
/// The format's.
pub fn writer<W: Write + Send>(
    to: W,
    like: &RecordBatch,
    told: Vec<KeyValue>,
) -> Result<ArrowWriter<W>, parquet::errors::ParquetError> {
    let level = ZstdLevel::try_new(LEVEL)?;
    let properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(level))
        .set_created_by("ironbird".into())
        .set_key_value_metadata(Some(told))
        .build();
    ArrowWriter::try_new(to, like.schema(), Some(properties))
}

/// What a file says of itself: whose rows it has, and of a chunk which ones and their sum.
#[must_use]
pub fn told(identity: &Identity, chunk: Option<(u64, Range<u64>)>, rows: Option<&RecordBatch>) -> Vec<KeyValue> {
    let Identity { name, campaign, build } = identity;
    let mut told = vec![
        ("schema", SCHEMA.to_owned()),
        ("name", name.clone()),
        ("campaign", campaign.clone()),
        ("build", build.clone()),
    ];
    if let Some((chunk, flights)) = chunk {
        told.push(("chunk", chunk.to_string()));
        told.push(("flights", format!("{}..{}", flights.start, flights.end)));
    }
    told.extend(rows.map(|rows| ("rows_sha256", sum_of(rows))));
    told.into_iter().map(|(key, value)| KeyValue::new(format!("ironbird.{key}"), value)).collect()
}

/// Whether the file of a chunk is whole and of this campaign and build.
#[must_use]
pub fn state(directory: &Path, campaign: &Campaign, identity: &Identity, chunk: u64) -> State {
    let path = path_of(directory, chunk);
    if !path.exists() {
        return State::Missing;
    }
    match read(&path).and_then(|(rows, says)| check(campaign, identity, chunk, &rows, &says)) {
        Ok(()) => State::Whole,
        Err(why) => State::Refused(why),
    }
}

/// The rows of a file, and what it says of itself.
type Contents = (RecordBatch, Vec<(String, String)>);

/// All of a file's rows at once.
///
/// # Errors
/// What is wrong with the file.
fn read(path: &Path) -> Result<Contents, String> {
    let broken = |e: &dyn std::fmt::Display| format!("it is broken: {e}");
    let file = failure::open_file(path).map_err(|e| broken(&e))?;
    let builder = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|e| broken(&e))?;
    let metadata = Arc::clone(builder.metadata());
    let says = metadata.file_metadata().key_value_metadata().into_iter().flatten();
    let says = says.filter_map(|it| Some((it.key.strip_prefix("ironbird.")?.to_owned(), it.value.clone()?))).collect();
    let rows = usize::try_from(metadata.file_metadata().num_rows()).unwrap_or_default();
    let mut reader = builder.with_batch_size(rows.max(1)).build().map_err(|e| broken(&e))?;
    let batch = reader.next().ok_or_else(|| broken(&"it has no rows"))?.map_err(|e| broken(&e))?;
    Ok((batch, says))
}

fn check(
    campaign: &Campaign,
    identity: &Identity,
    chunk: u64,
    rows: &RecordBatch,
    says: &[(String, String)],
) -> Result<(), String> {
    let said = |key: &str| says.iter().find(|(known, _)| known == key).map_or("", |(_, value)| value.as_str());
    if said("schema") != SCHEMA {
        return Err(format!("it is foreign: its form is `{}`, and not {SCHEMA}", said("schema")));
    }
    if said("campaign") != identity.campaign {
        let name = said("name");
        return Err(format!("it is foreign: of the campaign {name} with the fingerprint {}", said("campaign")));
    }
    if said("build") != identity.build {
        return Err(format!("another build flew it: {}", said("build")));
    }
    let flights = campaign.flights_of(chunk);
    if said("flights") != format!("{}..{}", flights.start, flights.end) {
        return Err(format!("it has the flights {}, and not {}..{}", said("flights"), flights.start, flights.end));
    }
    let numbers = rows.column(0).as_primitive_opt::<Int64Type>().ok_or("it is broken: its flights are no numbers")?;
    let expected = flights.flat_map(|flight| campaign.arms.iter().map(move |_| flight.cast_signed()));
    if !numbers.values().iter().copied().eq(expected) || said("rows_sha256") != sum_of(rows) {
        return Err("it is broken: its rows are not those that were written".into());
    }
    Ok(())
}

/// What lies in a directory of files of rows and is none of the campaign's: rows of chunks beyond its end, and rests.
///
/// # Errors
/// [`Failure`] names the directory.
pub fn others(directory: &Path, campaign: &Campaign) -> Result<Vec<String>, Failure> {
    let mut others = Vec::new();
    for entry in fs::read_dir(directory).in_file("list", directory)? {
        let name = entry.in_file("list", directory)?.file_name().to_string_lossy().into_owned();
        let number = name.strip_prefix("chunk-").and_then(|rest| rest.split('.').next()?.parse::<u64>().ok());
        let is_ours =
            number.is_some_and(|chunk| chunk < campaign.chunks() && path_of(directory, chunk).ends_with(&name));
        if name.starts_with("chunk-") && !is_ours {
            others.push(name);
        }
    }
    others.sort();
    Ok(others)
}
