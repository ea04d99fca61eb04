//! Files of rows: the flights of one chunk, whole or absent; and rows read back, a column at a time.

use std::fs::{self, File};
use std::io::{Read as _, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use errors::{Failure, InFile as _, write_whole};
use parquet::file::reader::{FileReader as _, SerializedFileReader};

use crate::campaign::Campaign;
use crate::parquet_file::{
    Metadata, encode, has_own_hash, metadata_of, read_column, read_table, write_rows, writer,
};
use crate::table::{Cell, Row, Table, TextRow};

pub const SCHEMA: &str = "ironbird-campaign/1";
/// The remedy for a file of rows that cannot be written.
const UNWRITTEN: &str =
    "make room, or fly into another directory that you can write (--out DIR); whole files are kept";

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    pub name: String,
    /// [`Campaign::fingerprint`].
    pub campaign: String,
    /// The build that flew: rows of another one may have other bits.
    pub build: String,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    Missing,
    /// All of its rows are there.
    Whole,
    Refused(String),
}

impl Campaign {
    pub const fn chunks(&self) -> u64 {
        self.flights.div_ceil(self.chunk)
    }

    pub fn flights_of(&self, chunk: u64) -> Range<u64> {
        let first = chunk * self.chunk;
        first..(first + self.chunk).min(self.flights)
    }

    /// The chunks of a shard, of which there are `of`, numbered from 1.
    pub fn shard(&self, number: u64, of: u64) -> Range<u64> {
        let cut =
            |shard: u64| (u128::from(self.chunks()) * u128::from(shard) / u128::from(of)) as u64;
        cut(number - 1)..cut(number)
    }
}

pub fn path_of(directory: &Path, chunk: u64) -> PathBuf {
    directory.join(format!("chunk-{chunk:07}.parquet"))
}

/// Writes the rows of a chunk aside, and gives the file its name when it is whole and on the disk.
pub fn write(
    directory: &Path,
    campaign: &Campaign,
    identity: &Identity,
    chunk: u64,
    rows: &[Row],
) -> Result<(), Failure> {
    let path = path_of(directory, chunk);
    let table = Table::new(campaign, rows);
    let bytes = encoded(identity, Some((chunk, campaign.flights_of(chunk))), &table)?;
    let written = write_whole(&path, |file| file.write_all(&bytes));
    let written = written.in_file("write", &path);
    written.map_err(|failure| failure.help(UNWRITTEN))
}

/// Bytes that a file of these rows takes.
pub fn length(campaign: &Campaign, identity: &Identity, rows: &[Row]) -> Result<usize, Failure> {
    encoded(identity, None, &Table::new(campaign, rows)).map(|bytes| bytes.len())
}

fn encoded(
    identity: &Identity,
    chunk: Option<(u64, Range<u64>)>,
    table: &Table,
) -> Result<Vec<u8>, Failure> {
    encode(table, &metadata(identity, chunk, Some(table)))
        .map_err(|e| Failure::failed(format!("rows of flights: {e}")))
}

/// Metadata of a file: the campaign and build of its rows, and of a chunk its flights and their hash.
fn metadata(
    identity: &Identity,
    chunk: Option<(u64, Range<u64>)>,
    rows: Option<&Table>,
) -> Metadata {
    let mut metadata = vec![
        ("schema", SCHEMA.to_owned()),
        ("name", identity.name.clone()),
        ("campaign", identity.campaign.clone()),
        ("build", identity.build.clone()),
    ];
    if let Some((chunk, flights)) = chunk {
        metadata.push(("chunk", chunk.to_string()));
        metadata.push(("flights", format!("{flights:?}")));
    }
    metadata.extend(rows.map(|rows| ("rows_sha256", rows.rows_sha256())));
    metadata
}

pub fn state(directory: &Path, campaign: &Campaign, identity: &Identity, chunk: u64) -> State {
    let path = path_of(directory, chunk);
    match check(&path, campaign, identity, chunk) {
        _ if !path.exists() => State::Missing,
        Ok(()) => State::Whole,
        Err(why) => State::Refused(why),
    }
}

fn check(path: &Path, campaign: &Campaign, identity: &Identity, chunk: u64) -> Result<(), String> {
    let broken = |e: &dyn std::fmt::Display| format!("it is broken: {e}");
    let mut file = errors::open_file(path).map_err(|e| broken(&e))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(|e| broken(&e))?;
    let has_own_hash = has_own_hash(&bytes);
    if has_own_hash == Some(false) {
        return Err("it is broken: it does not have the hash that it was written with".into());
    }
    let reader = SerializedFileReader::new(file).map_err(|e| broken(&e))?;
    let metadata = metadata_of(reader.metadata());
    let value = |key: &str| {
        let pair = metadata.iter().find(|(known, _)| known == key);
        pair.map_or("", |(_, value)| value.as_str())
    };
    let (schema, name, fingerprint) = (value("schema"), value("name"), value("campaign"));
    let (build, flown) = (value("build"), value("flights"));
    let flights = campaign.flights_of(chunk);
    let why = if schema != SCHEMA {
        format!("it is foreign: its form is `{schema}`, and not {SCHEMA}")
    } else if fingerprint != identity.campaign {
        format!("it is foreign: of the campaign {name} with the fingerprint {fingerprint}")
    } else if build != identity.build {
        format!("another build flew it: {build}")
    } else if flown != format!("{flights:?}") {
        format!("it has the flights {flown}, and not {flights:?}")
    } else if has_own_hash.is_none() {
        "it is broken: it has no hash of itself".into()
    } else {
        String::new()
    };
    if !why.is_empty() {
        return Err(why);
    }
    let rows = read_table(&reader, Table::new(campaign, &[])).map_err(|e| broken(&e))?;
    let numbers = flights.flat_map(|flight| vec![flight.cast_signed(); campaign.arms.len()]);
    let expected = numbers.map(|flight| Some(Cell::Integer(flight)));
    let is_expected = rows.columns[0].cells.iter().cloned().eq(expected);
    if !is_expected || value("rows_sha256") != rows.rows_sha256() {
        return Err("it is broken: its rows are not those that were written".into());
    }
    Ok(())
}

/// Files of a directory that are none of the campaign's: rows of chunks beyond its end, and incomplete ones.
pub fn others(directory: &Path, campaign: &Campaign) -> Result<Vec<String>, Failure> {
    let mut others = Vec::new();
    for entry in fs::read_dir(directory).in_file("list", directory)? {
        let name = entry.in_file("list", directory)?.file_name();
        let name = name.to_string_lossy().into_owned();
        let Some(rest) = name.strip_prefix("chunk-") else {
            continue;
        };
        let number = rest.split('.').next().and_then(|it| it.parse::<u64>().ok());
        let number = number.filter(|chunk| *chunk < campaign.chunks());
        if !number.is_some_and(|chunk| path_of(directory, chunk).ends_with(&name)) {
            others.push(name);
        }
    }
    others.sort();
    Ok(others)
}

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

    /// Each word of a column as its place in the list of the first `most` different ones, and this list; the rest count as
    /// `others`, at its end.
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
        if places.contains(&(most as u32)) {
            words.push("others".into());
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
        Ok((place < table.rows()).then(|| table.text_row(place)))
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
        let write = |file: &mut File| {
            let refused = |e: parquet::errors::ParquetError| Failure::failed(e.to_string());
            let metadata = metadata(identity, None, None);
            let mut writer = writer(file, &table, &metadata, None).map_err(refused)?;
            for (i, path) in self.files.iter().enumerate() {
                table.append(read(path, campaign)?);
                if table.rows() >= GROUP || i + 1 == self.files.len() {
                    rows += table.rows() as u64;
                    write_rows(&mut writer, &table).map_err(refused)?;
                    table = Table::new(campaign, &[]);
                }
            }
            writer.close().map(drop).map_err(refused)
        };
        write_whole(to, write).in_file("write", to)?;
        Ok(rows)
    }
}

fn read(path: &Path, campaign: &Campaign) -> Result<Table, Failure> {
    let file = File::open(path).in_file("read", path)?;
    SerializedFileReader::new(file)
        .and_then(|reader| read_table(&reader, Table::new(campaign, &[])))
        .in_file("read", path)
}
