//! Tables as Parquet files, column by column.
//!
//! A chunk's file holds a hash of itself: SHA-256 over the file with the 64 digits of the hash set to `0`. A file
//! depends on nothing but its table and metadata.

use std::fs::File;
use std::io::Write;
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

use crate::table::{Column, Table, Values, hex};

/// Level of compression: higher ones take longer than they save.
const LEVEL: i32 = 3;
const FILE_HASH: &str = "ironbird.file_sha256";
const HASH_DIGITS: usize = 64;

/// Keys and values that describe a file; the file has them with the prefix `ironbird.`.
pub type Metadata = Vec<(&'static str, String)>;

/// A table as the bytes of a file, with the file's hash.
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
    hex(&hash)
}

/// A writer of tables with these columns, units and meanings.
pub fn writer<W: Write + Send>(
    to: W,
    like: &Table,
    metadata: &Metadata,
    more: Option<KeyValue>,
) -> Result<SerializedFileWriter<W>> {
    let mut pairs: Vec<KeyValue> = metadata
        .iter()
        .map(|(key, value)| KeyValue::new(format!("ironbird.{key}"), value.clone()))
        .collect();
    for column in &like.columns {
        let described = [("unit", column.unit), ("meaning", &column.meaning)];
        pairs.extend(
            described
                .into_iter()
                .filter(|(_, text)| !text.is_empty())
                .map(|(key, text)| {
                    KeyValue::new(format!("{key}.{}", column.name), text.to_owned())
                }),
        );
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
    let fields: Result<Vec<TypePtr>> = table.columns.iter().map(field).collect();
    let schema = Type::group_type_builder("schema")
        .with_fields(fields?)
        .build()?;
    Ok(Arc::new(schema))
}

fn field(column: &Column) -> Result<TypePtr> {
    let (physical, logical) = match column.values {
        Values::Numbers(_) => (Physical::DOUBLE, None),
        Values::Integers(_) => (Physical::INT64, None),
        Values::Flags(_) => (Physical::BOOLEAN, None),
        Values::Texts(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
    };
    let repetition = if column.optional {
        Repetition::OPTIONAL
    } else {
        Repetition::REQUIRED
    };
    let field = Type::primitive_type_builder(&column.name, physical)
        .with_repetition(repetition)
        .with_logical_type(logical)
        .build()?;
    Ok(Arc::new(field))
}

/// Writes a table as one group of rows.
pub fn write_rows<W: Write + Send>(
    writer: &mut SerializedFileWriter<W>,
    table: &Table,
) -> Result<()> {
    let mut group = writer.next_row_group()?;
    for column in &table.columns {
        let mut to = group
            .next_column()?
            .ok_or_else(|| ParquetError::General("too many columns".into()))?;
        match &column.values {
            Values::Numbers(values) => write::<DoubleType>(&mut to, values.iter().copied()),
            Values::Integers(values) => write::<Int64Type>(&mut to, values.iter().copied()),
            Values::Flags(values) => write::<BoolType>(&mut to, values.iter().copied()),
            Values::Texts(values) => {
                let texts = values
                    .iter()
                    .map(|text| text.as_deref().map(ByteArray::from));
                write::<ByteArrayType>(&mut to, texts)
            }
        }?;
        to.close()?;
    }
    group.close().map(drop)
}

/// Writes a column: for each row whether it has a value, and the values. A column without gaps ignores the former.
fn write<T: DataType>(
    to: &mut SerializedColumnWriter<'_>,
    rows: impl Iterator<Item = Option<T::T>> + Clone,
) -> Result<()> {
    let levels: Vec<i16> = rows.clone().map(|row| i16::from(row.is_some())).collect();
    let values: Vec<T::T> = rows.flatten().collect();
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

/// A column of a file.
pub fn read_column(path: &Path, name: &str) -> std::result::Result<Values, Failure> {
    let file = File::open(path).in_file("read", path)?;
    let reader = SerializedFileReader::new(file).in_file("read", path)?;
    let fields = reader.metadata().file_metadata().schema_descr();
    let place = fields.columns().iter().position(|it| it.name() == name);
    let missing = || ParquetError::General(format!("it has no column {name}"));
    place
        .ok_or_else(missing)
        .and_then(|place| read_values(&reader, place))
        .in_file("read", path)
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
        let values = read_values(reader, place)?;
        if std::mem::discriminant(&values) != std::mem::discriminant(&column.values) {
            let name = &column.name;
            return Err(ParquetError::General(format!("{name} has another type")));
        }
        column.values = values;
    }
    Ok(table)
}

fn read_values(
    reader: &SerializedFileReader<impl ChunkReader + 'static>,
    place: usize,
) -> Result<Values> {
    let fields = reader.metadata().file_metadata().schema_descr();
    let mut values = match fields.column(place).physical_type() {
        Physical::DOUBLE => Values::Numbers(Vec::new()),
        Physical::INT64 => Values::Integers(Vec::new()),
        Physical::BOOLEAN => Values::Flags(Vec::new()),
        _ => Values::Texts(Vec::new()),
    };
    for number in 0..reader.num_row_groups() {
        let group = reader.get_row_group(number)?;
        let rows = usize::try_from(group.metadata().num_rows())?;
        match (group.get_column_reader(place)?, &mut values) {
            (ColumnReader::DoubleColumnReader(from), Values::Numbers(to)) => {
                read(from, rows, to, Ok)?;
            }
            (ColumnReader::Int64ColumnReader(from), Values::Integers(to)) => {
                read(from, rows, to, Ok)?;
            }
            (ColumnReader::BoolColumnReader(from), Values::Flags(to)) => read(from, rows, to, Ok)?,
            (ColumnReader::ByteArrayColumnReader(from), Values::Texts(to)) => {
                read(from, rows, to, |bytes| Ok(bytes.as_utf8()?.to_owned()))?;
            }
            _ => return Err(ParquetError::General("a column has an unknown type".into())),
        }
    }
    Ok(values)
}

fn read<T: DataType, V>(
    mut from: ColumnReaderImpl<T>,
    rows: usize,
    to: &mut Vec<Option<V>>,
    convert: impl Fn(T::T) -> Result<V>,
) -> Result<()> {
    let (mut levels, mut values) = (Vec::new(), Vec::new());
    let (read, ..) = from.read_records(rows, Some(&mut levels), None, &mut values)?;
    if read != rows {
        return Err(ParquetError::General("a column has too few rows".into()));
    }
    let mut values = values.into_iter().map(convert);
    if levels.is_empty() {
        levels.resize(rows, 1);
    }
    for level in levels {
        to.push(if level == 0 {
            None
        } else {
            values.next().transpose()?
        });
    }
    Ok(())
}
