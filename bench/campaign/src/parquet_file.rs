//! Tables as Parquet files, column by column.
//!
//! A chunk's file holds a hash of itself: SHA-256 over the file with the 64 digits of the hash set to `0`. A file
//! depends on nothing but its table and metadata.

use std::fs::File;
use std::io::{self, Write};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use errors::{Failure, InFile as _};
use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical, ZstdLevel};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::{ParquetError, Result};
use parquet::file::metadata::{KeyValue, ParquetMetaData};
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{ChunkReader, FileReader as _, SerializedFileReader};
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::{Type, TypePtr};
use sha2::{Digest as _, Sha256};

use crate::campaign::hex;
use crate::table::{Cell, Cells, Column, Kind, Table};

/// Level of compression: higher ones take longer than they save.
const LEVEL: i32 = 3;
const FILE_HASH: &str = "ironbird.file_sha256";
const HASH_DIGITS: usize = 64;

/// Keys and values that describe a file; the file has them with the prefix `ironbird.`.
pub type Metadata = Vec<(&'static str, String)>;

/// Rows of a row group: of more, all would be in memory.
const GROUP_ROWS: usize = 10_000;

/// A file that is written row by row.
pub struct RowWriter<W: Write + Send> {
    file: SerializedFileWriter<W>,
    group: Table,
}

impl<W: Write + Send> RowWriter<W> {
    /// Begins a file with these columns, which have no cells.
    pub fn new(to: W, columns: Vec<Column>) -> io::Result<Self> {
        let group = Table { columns };
        let file = writer(to, &group, &Metadata::new(), None).map_err(io_error)?;
        Ok(Self { file, group })
    }

    /// Adds a row with a cell for each column.
    pub fn push(&mut self, row: impl Iterator<Item = Option<Cell>>) -> io::Result<()> {
        for (column, cell) in self.group.columns.iter_mut().zip(row) {
            column.cells.push(cell);
        }
        match self.group.rows() >= GROUP_ROWS {
            true => self.flush(),
            false => Ok(()),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        write_rows(&mut self.file, &self.group).map_err(io_error)?;
        for column in &mut self.group.columns {
            column.cells.clear();
        }
        Ok(())
    }

    pub fn finish(&mut self) -> io::Result<()> {
        if self.group.rows() > 0 {
            self.flush()?;
        }
        self.file.finish().map(drop).map_err(io_error)
    }
}

/// The error of the file behind the writer, if it is one.
fn io_error(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(error) => error
            .downcast::<io::Error>()
            .map_or_else(io::Error::other, |error| *error),
        error => io::Error::other(error),
    }
}

pub fn encode(table: &Table, metadata: &Metadata) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let placeholder = KeyValue::new(FILE_HASH.into(), "0".repeat(HASH_DIGITS));
    let mut writer = writer(&mut bytes, table, metadata, Some(placeholder))?;
    write_rows(&mut writer, table)?;
    writer.close()?;
    if let Some(place) = hash_place(&bytes) {
        let hash = file_hash(&bytes, &place);
        bytes[place].copy_from_slice(hash.as_bytes());
    }
    Ok(bytes)
}

/// Whether the bytes of a file have the hash that the file holds; `None` for a file without one.
pub fn has_own_hash(bytes: &[u8]) -> Option<bool> {
    let place = hash_place(bytes)?;
    Some(file_hash(bytes, &place).as_bytes() == &bytes[place])
}

/// Where the digits of the hash are: behind its key, the header of the value's field and the value's length.
fn hash_place(bytes: &[u8]) -> Option<Range<usize>> {
    let key = bytes
        .windows(FILE_HASH.len())
        .rposition(|window| window == FILE_HASH.as_bytes())?;
    let start = key + FILE_HASH.len() + 2;
    let place = start..start + HASH_DIGITS;
    (place.end <= bytes.len()).then_some(place)
}

fn file_hash(bytes: &[u8], place: &Range<usize>) -> String {
    let mut hash = Sha256::new();
    hash.update(&bytes[..place.start]);
    hash.update([b'0'; HASH_DIGITS]);
    hash.update(&bytes[place.end..]);
    hex(hash)
}

pub fn writer<W: Write + Send>(
    to: W,
    like: &Table,
    metadata: &Metadata,
    more: Option<KeyValue>,
) -> Result<SerializedFileWriter<W>> {
    let pair =
        |(key, value): &(&str, String)| KeyValue::new(format!("ironbird.{key}"), value.clone());
    let mut pairs: Vec<KeyValue> = metadata.iter().map(pair).collect();
    for column in &like.columns {
        for (key, text) in [("unit", &column.unit), ("meaning", &column.meaning)] {
            if !text.is_empty() {
                let key = format!("{key}.{}", column.name);
                pairs.push(KeyValue::new(key, text.clone()));
            }
        }
    }
    pairs.extend(more);
    let properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(LEVEL)?))
        .set_created_by("ironbird".into())
        .set_key_value_metadata(Some(pairs))
        .build();
    SerializedFileWriter::new(to, schema(like)?, Arc::new(properties))
}

fn schema(table: &Table) -> Result<TypePtr> {
    let fields = table.columns.iter().map(field).collect::<Result<_>>()?;
    let schema = Type::group_type_builder("schema").with_fields(fields);
    schema.build().map(Arc::new)
}

fn field(column: &Column) -> Result<TypePtr> {
    let (physical, logical) = match column.kind {
        Kind::Number => (Physical::DOUBLE, None),
        Kind::Integer => (Physical::INT64, None),
        Kind::Unsigned => {
            let unsigned = LogicalType::integer(64, false);
            (Physical::INT64, Some(unsigned))
        }
        Kind::Flag => (Physical::BOOLEAN, None),
        Kind::Text => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
    };
    let repetition = match column.optional {
        true => Repetition::OPTIONAL,
        false => Repetition::REQUIRED,
    };
    Type::primitive_type_builder(&column.name, physical)
        .with_repetition(repetition)
        .with_logical_type(logical)
        .build()
        .map(Arc::new)
}

pub fn write_rows<W: Write + Send>(
    writer: &mut SerializedFileWriter<W>,
    table: &Table,
) -> Result<()> {
    let mut group = writer.next_row_group()?;
    for column in &table.columns {
        let mut to = group
            .next_column()?
            .ok_or_else(|| ParquetError::General("too many columns".into()))?;
        let cells = &column.cells;
        match column.kind {
            Kind::Number => write::<DoubleType>(&mut to, cells, |cell| match cell {
                Cell::Number(number) => Some(*number),
                _ => None,
            }),
            Kind::Integer | Kind::Unsigned => {
                write::<Int64Type>(&mut to, cells, |cell| match cell {
                    Cell::Integer(integer) => Some(*integer),
                    _ => None,
                })
            }
            Kind::Flag => write::<BoolType>(&mut to, cells, |cell| match cell {
                Cell::Flag(flag) => Some(*flag),
                _ => None,
            }),
            Kind::Text => write::<ByteArrayType>(&mut to, cells, |cell| match cell {
                Cell::Text(text) => Some(ByteArray::from(text.as_str())),
                _ => None,
            }),
        }?;
        to.close()?;
    }
    group.close().map(drop)
}

/// Writes a column: for each row whether it has a value, and the values. A column without gaps ignores the former.
fn write<T: DataType>(
    to: &mut SerializedColumnWriter<'_>,
    cells: &[Option<Cell>],
    value: impl Fn(&Cell) -> Option<T::T>,
) -> Result<()> {
    let levels: Vec<i16> = cells.iter().map(|cell| i16::from(cell.is_some())).collect();
    let values: Vec<T::T> = cells.iter().flatten().filter_map(value).collect();
    to.typed::<T>()
        .write_batch(&values, Some(&levels), None)
        .map(drop)
}

/// The pairs of a file's metadata that begin with `ironbird.`, without that prefix.
pub fn metadata_of(metadata: &ParquetMetaData) -> Vec<(String, String)> {
    let pairs = metadata.file_metadata().key_value_metadata();
    pairs
        .into_iter()
        .flatten()
        .filter_map(|pair| {
            let key = pair.key.strip_prefix("ironbird.")?;
            Some((key.to_owned(), pair.value.clone()?))
        })
        .collect()
}

pub fn read_column(path: &Path, name: &str) -> std::result::Result<Cells, Failure> {
    let file = File::open(path).in_file("read", path)?;
    let reader = SerializedFileReader::new(file).in_file("read", path)?;
    let fields = reader.metadata().file_metadata().schema_descr();
    let place = fields.columns().iter().position(|it| it.name() == name);
    let missing = || ParquetError::General(format!("it has no column {name}"));
    place
        .ok_or_else(missing)
        .and_then(|place| read_cells(&reader, place))
        .in_file("read", path)
}

/// Name and cells of each column.
pub fn read_columns(path: &Path) -> std::result::Result<Vec<(String, Cells)>, Failure> {
    let file = File::open(path).in_file("read", path)?;
    let reader = SerializedFileReader::new(file).in_file("read", path)?;
    let fields = reader.metadata().file_metadata().schema_descr();
    let column = |(place, name): (usize, &str)| Ok((name.to_owned(), read_cells(&reader, place)?));
    let names = fields.columns().iter().map(|it| it.name());
    let columns: Result<_> = names.enumerate().map(column).collect();
    columns.in_file("read", path)
}

/// All rows of a file, with the columns' units and meanings as `like` has them.
pub fn read_table(
    reader: &SerializedFileReader<impl ChunkReader + 'static>,
    like: Table,
) -> Result<Table> {
    let mut table = like;
    let fields = reader.metadata().file_metadata().schema_descr();
    let names = fields.columns().iter().map(|it| it.name());
    if !names.eq(table.columns.iter().map(|column| column.name.as_str())) {
        return Err(ParquetError::General("it has other columns".into()));
    }
    for (place, column) in table.columns.iter_mut().enumerate() {
        if field(column)?.get_physical_type() != fields.column(place).physical_type() {
            let name = &column.name;
            return Err(ParquetError::General(format!("{name} has another type")));
        }
        column.cells = read_cells(reader, place)?;
    }
    Ok(table)
}

fn read_cells(
    reader: &SerializedFileReader<impl ChunkReader + 'static>,
    place: usize,
) -> Result<Cells> {
    let mut cells = Vec::new();
    for number in 0..reader.num_row_groups() {
        let group = reader.get_row_group(number)?;
        let rows = usize::try_from(group.metadata().num_rows())?;
        match group.get_column_reader(place)? {
            ColumnReader::DoubleColumnReader(from) => {
                read(from, rows, &mut cells, |number| Ok(Cell::Number(number)))
            }
            ColumnReader::Int64ColumnReader(from) => {
                read(from, rows, &mut cells, |integer| Ok(Cell::Integer(integer)))
            }
            ColumnReader::BoolColumnReader(from) => {
                read(from, rows, &mut cells, |flag| Ok(Cell::Flag(flag)))
            }
            ColumnReader::ByteArrayColumnReader(from) => read(from, rows, &mut cells, |bytes| {
                Ok(Cell::Text(bytes.as_utf8()?.to_owned()))
            }),
            _ => Err(ParquetError::General("a column has an unknown type".into())),
        }?;
    }
    Ok(cells)
}

fn read<T: DataType>(
    mut from: ColumnReaderImpl<T>,
    rows: usize,
    to: &mut Cells,
    convert: impl Fn(T::T) -> Result<Cell>,
) -> Result<()> {
    let (mut levels, mut values) = (Vec::new(), Vec::new());
    let (read, ..) = from.read_records(rows, Some(&mut levels), None, &mut values)?;
    if read != rows {
        return Err(ParquetError::General("a column has too few rows".into()));
    }
    let mut values = values.into_iter().map(convert);
    // A column without gaps has no levels.
    for row in 0..rows {
        let cell = match levels.get(row) {
            Some(0) => None,
            _ => values.next().transpose()?,
        };
        to.push(cell);
    }
    Ok(())
}
