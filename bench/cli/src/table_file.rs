//! A table as a file: CSV, JSON lines, Parquet or a MAT file.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use campaign::parquet_file::RowWriter;
use campaign::table::{Cell as Typed, Column as TypedColumn, Kind};
use errors::AsideFile;
use flight_log::rows::{Cell, Column};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableFormat {
    Csv,
    Json,
    Parquet,
    Mat,
}

impl TableFormat {
    pub const ALL: [Self; 4] = [Self::Csv, Self::Json, Self::Parquet, Self::Mat];

    pub const fn ending(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Json => "jsonl",
            Self::Parquet => "parquet",
            Self::Mat => "mat",
        }
    }
}

pub type Out = Box<dyn Write + Send>;

pub struct TableFile {
    columns: Vec<Column>,
    pub rows: u64,
    to: To,
    /// None of a table on standard output.
    file: Option<AsideFile>,
}

enum To {
    Csv(Out),
    Json(Out),
    Parquet(RowWriter<Out>),
    /// The columns so far: each is a variable, and its length stands before it.
    Mat(Out, Vec<Vec<f64>>),
}

impl TableFile {
    /// Begins a file, which gets its name when the table is finished.
    pub fn create(format: TableFormat, path: &Path, columns: Vec<Column>) -> io::Result<Self> {
        let file = AsideFile::create(path)?;
        let out = Box::new(BufWriter::new(file.file()?));
        Ok(Self {
            file: Some(file),
            ..Self::begin(format, out, columns)?
        })
    }

    /// Begins a table; the names of its columns are in it also if no row follows.
    pub fn begin(format: TableFormat, mut out: Out, columns: Vec<Column>) -> io::Result<Self> {
        let to = match format {
            TableFormat::Csv => {
                let names = columns.iter().map(|column| &*column.name);
                writeln!(out, "{}", names.collect::<Vec<_>>().join(","))?;
                To::Csv(out)
            }
            TableFormat::Json => To::Json(out),
            TableFormat::Parquet => {
                To::Parquet(RowWriter::new(out, columns.iter().map(typed).collect())?)
            }
            TableFormat::Mat => To::Mat(out, vec![Vec::new(); columns.len()]),
        };
        Ok(Self {
            columns,
            rows: 0,
            to,
            file: None,
        })
    }

    /// Adds a row with a cell for each column.
    pub fn push(&mut self, row: &[Cell]) -> io::Result<()> {
        self.rows += 1;
        match &mut self.to {
            To::Csv(out) => {
                let cells = row.iter().map(Cell::to_string);
                writeln!(out, "{}", cells.collect::<Vec<_>>().join(","))
            }
            To::Json(out) => {
                let pair = |(column, cell): (&Column, &Cell)| {
                    format!("\"{}\":{}", column.name, json(*cell))
                };
                let pairs = self.columns.iter().zip(row).map(pair);
                writeln!(out, "{{{}}}", pairs.collect::<Vec<_>>().join(","))
            }
            To::Parquet(file) => file.push(row.iter().map(|cell| match *cell {
                Cell::Missing => None,
                Cell::Integer(integer) => Some(Typed::Integer(integer.cast_signed())),
                Cell::Number(number) => Some(Typed::Number(number)),
            })),
            To::Mat(_, columns) => {
                for (column, cell) in columns.iter_mut().zip(row) {
                    column.push(cell.number());
                }
                Ok(())
            }
        }
    }

    pub fn finish(&mut self) -> io::Result<()> {
        match &mut self.to {
            To::Csv(out) | To::Json(out) => out.flush(),
            To::Parquet(file) => file.finish(),
            To::Mat(out, columns) => {
                out.write_all(&mat_header())?;
                for (column, values) in self.columns.iter().zip(columns) {
                    write_mat(out, &column.name.replace('.', "_"), values)?;
                }
                out.flush()
            }
        }?;
        self.file.as_ref().map_or(Ok(()), AsideFile::keep)
    }
}

fn typed(column: &Column) -> TypedColumn {
    TypedColumn {
        name: column.name.clone(),
        unit: column.unit.clone(),
        meaning: String::new(),
        kind: if column.is_number {
            Kind::Number
        } else {
            Kind::Unsigned
        },
        optional: true,
        cells: Vec::new(),
    }
}

/// JSON has no numbers that are not finite; no message that passed inspection holds one.
fn json(cell: Cell) -> String {
    match cell {
        Cell::Integer(_) => cell.to_string(),
        Cell::Number(number) if number.is_finite() => cell.to_string(),
        _ => "null".into(),
    }
}

/// Header of a MAT file of level 5: text, version, and the mark of little-endian numbers.
fn mat_header() -> [u8; 128] {
    let mut header = [b' '; 128];
    let text = b"MATLAB 5.0 MAT-file, written by ironbird";
    header[..text.len()].copy_from_slice(text);
    // No subsystem data.
    header[116..124].fill(0);
    header[124..].copy_from_slice(&[0, 1, b'I', b'M']);
    header
}

/// Writes a variable: a column of doubles.
fn write_mat(out: &mut impl Write, name: &str, values: &[f64]) -> io::Result<()> {
    const INT8: u32 = 1;
    const INT32: u32 = 5;
    const UINT32: u32 = 6;
    const DOUBLE: u32 = 9;
    const MATRIX: u32 = 14;
    const DOUBLE_ARRAY: u32 = 6;
    let too_large = || {
        io::Error::other(
            "the flight is too long for a MAT file: allowed are 500 million rows; use --format parquet",
        )
    };
    let bytes = u32::try_from(size_of_val(values)).map_err(|_| too_large())?;
    let name_bytes = name.len() as u32;
    // Every part begins at a multiple of 8 bytes.
    let padded = name_bytes.next_multiple_of(8);
    let tags = 4 * 8;
    let size = (tags + 8 + 8 + padded)
        .checked_add(bytes)
        .ok_or_else(too_large)?;
    let rows = values.len() as u32;
    for word in [
        [MATRIX, size],
        [UINT32, 8],
        [DOUBLE_ARRAY, 0],
        [INT32, 8],
        [rows, 1],
        [INT8, name_bytes],
    ]
    .as_flattened()
    {
        out.write_all(&word.to_le_bytes())?;
    }
    out.write_all(name.as_bytes())?;
    out.write_all(&[0; 8][..(padded - name_bytes) as usize])?;
    for word in [DOUBLE, bytes] {
        out.write_all(&word.to_le_bytes())?;
    }
    values
        .iter()
        .try_for_each(|value| out.write_all(&value.to_le_bytes()))
}
