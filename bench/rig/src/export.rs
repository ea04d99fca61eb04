//! `ironbird export`: the messages of a flight as CSV or JSON, for tools that cannot read MCAP, and the stages'
//! execution times as a Perfetto trace.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use messages::content::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::header::Message;
use messages::monitor::Monitor;
use messages::topic::Topic;

use crate::cli::{ExportArgs, ExportFormat};
use crate::output::{print, say};
use crate::run_directory::find_log;
use errors::{Failure, InFile as _, OK, replace};
use flight_log::codec::Logged;
use flight_log::entry::LogEntry;
use flight_log::perfetto;
use flight_log::perfetto::PerfettoWriter;
use flight_log::reader::{End, Kept, LogReader};
use flight_log::{TOPICS, rows, topics};
use report::phrase::count;

/// Subdirectory of the run directory for the exported tables.
pub const DIRECTORY: &str = "export";

/// Whether an export creates a file of this name.
pub fn is_ours(name: &str) -> bool {
    let formats = [TableFormat::Csv, TableFormat::Json];
    topics().any(|topic| {
        formats
            .iter()
            .any(|format| name == format!("{topic}.{}", format.extension()))
    })
}

pub fn export(args: &ExportArgs) -> Result<u8, Failure> {
    let path = find_log(&args.run, args.out.as_deref())?;
    let mut reader = LogReader::open(&path)?;
    let run_directory = path.parent().unwrap_or(Path::new("."));
    let format = match args.format {
        ExportFormat::Csv => TableFormat::Csv,
        ExportFormat::Json => TableFormat::Json,
        ExportFormat::Perfetto if args.topic.is_some() => {
            return Err(
                Failure::usage("a Perfetto trace contains all stages, not one topic")
                    .help("omit --topic"),
            );
        }
        ExportFormat::Perfetto => {
            return trace(&mut reader, args.to.as_deref().unwrap_or(run_directory));
        }
    };
    let mut tables = match &args.topic {
        Some(topic) => Tables::one(topic, format)?,
        None => Tables::all(
            args.to
                .clone()
                .unwrap_or_else(|| run_directory.join(DIRECTORY)),
            format,
        )?,
    };
    // Everything before a damaged part is exported, then the damage is reported.
    let read = tables.fill(&mut reader).and_then(|()| tables.finish());
    print(&tables.summary())?;
    read?;
    if let Some(topic) = args
        .topic
        .as_deref()
        .filter(|topic| tables.is_read && !tables.open.contains_key(topic))
    {
        let role = topic.split('_').next().unwrap_or_default();
        return Err(Failure::usage(format!(
            "{} has no topic {topic}: the {role} law of this flight publishes no signals",
            path.display()
        ))
        .help("`ironbird laws NAME` lists a law's signals; `ironbird export` without --topic exports every topic"));
    }
    // A reader that closed the pipe did not want the end.
    if tables.is_read {
        print_missing(&reader)?;
    }
    Ok(OK)
}

/// Prints what the log, and therefore the export, lacks.
fn print_missing(reader: &LogReader) -> Result<(), Failure> {
    let Ok(Kept {
        around_ticks,
        files_before,
    }) = reader.kept()
    else {
        return Ok(());
    };
    let path = reader.path();
    if let Some(ticks) = around_ticks {
        say(&format!(
            "{} contains excerpts: {ticks} ticks before and after missed deadlines, parameter changes, take-off and landing\n",
            path.display()
        ));
    }
    if files_before > 0 {
        say(&format!(
            "{} is not the first file of the log; earlier files missing: {files_before}\n",
            path.display()
        ));
    }
    if reader.end() == End::Truncated {
        say(&format!(
            "{} is truncated; everything up to that point was exported\n",
            path.display()
        ));
    }
    for (topic, missing) in reader.missing()? {
        let missing = count(missing, "message");
        say(&format!(
            "{} lacks {missing} of topic {topic}: the disk was full\n",
            path.display()
        ));
    }
    Ok(())
}

/// Writes the stages' execution times as a Perfetto trace.
fn trace(reader: &mut LogReader, directory: &Path) -> Result<u8, Failure> {
    create_directory(directory)?;
    let path = directory.join(perfetto::FILE);
    let file = replace(&path)?;
    let mut writer = PerfettoWriter::new(BufWriter::new(file)).in_file("write", &path)?;
    let read = loop {
        let entry = match reader.next_entry() {
            Ok(Some(entry)) => entry,
            Ok(None) => break Ok(()),
            // Everything before the damage is exported.
            Err(failure) => break Err(failure),
        };
        match entry {
            LogEntry::State(message) => writer.state(message),
            LogEntry::Setpoint(message) => writer.work(message),
            LogEntry::Wrench(message) => writer.work(message),
            LogEntry::RotorSpeeds(message) => writer.work(message),
            LogEntry::Swap(message) => writer.swap(message),
            LogEntry::Theorem(_) => Ok(()),
        }
        .in_file("write", &path)?;
    };
    writer.finish().in_file("write", &path)?;
    print(&format!(
        "{:>8} slices, {} instants  {}\n",
        writer.slices,
        writer.instants,
        path.display()
    ))?;
    read?;
    print_missing(reader)?;
    Ok(OK)
}

fn create_directory(directory: &Path) -> Result<(), Failure> {
    fs::create_dir_all(directory).map_err(|e| {
        Failure::usage(format!("cannot export into {}: {e}", directory.display()))
            .help("name a writable directory: --to DIR")
    })
}

#[derive(Clone, Copy)]
enum TableFormat {
    Csv,
    Json,
}

impl TableFormat {
    const fn extension(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Json => "jsonl",
        }
    }
}

struct Tables {
    format: TableFormat,
    /// None for standard output.
    directory: Option<PathBuf>,
    wanted: Vec<&'static str>,
    open: BTreeMap<&'static str, Table>,
    is_read: bool,
}

struct Table {
    out: Box<dyn Write>,
    messages: u64,
}

impl Table {
    /// Writes the header line, also if no message follows.
    fn new(
        columns: &[String],
        format: TableFormat,
        out: impl Write + 'static,
    ) -> (Self, io::Result<()>) {
        let mut out: Box<dyn Write> = Box::new(BufWriter::new(out));
        let begun = match format {
            TableFormat::Csv => writeln!(out, "{}", columns.join(",")),
            TableFormat::Json => Ok(()),
        };
        (Self { out, messages: 0 }, begun)
    }
}

fn columns(topic: &str) -> Vec<String> {
    match topic {
        State::NAME => rows::columns::<State>(),
        Setpoint::NAME => rows::columns::<Setpoint>(),
        Wrench::NAME => rows::columns::<Wrench>(),
        RotorSpeeds::NAME => rows::columns::<RotorSpeeds>(),
        SwapRecord::NAME => rows::columns::<SwapRecord>(),
        _ => rows::columns::<Monitor>(),
    }
}

impl Tables {
    /// One table, on standard output. The columns of a law's signals are known once the log has been opened.
    fn one(topic: &str, format: TableFormat) -> Result<Self, Failure> {
        let wanted = topics().filter(|name| *name == topic).collect();
        let mut tables = Self {
            format,
            directory: None,
            wanted,
            open: BTreeMap::new(),
            is_read: true,
        };
        tables.begin_all()?;
        Ok(tables)
    }

    fn all(directory: PathBuf, format: TableFormat) -> Result<Self, Failure> {
        create_directory(&directory)?;
        let wanted = topics().collect();
        let mut tables = Self {
            format,
            directory: Some(directory),
            wanted,
            open: BTreeMap::new(),
            is_read: true,
        };
        tables.begin_all()?;
        Ok(tables)
    }

    /// Starts the tables whose columns are known before the log is read.
    fn begin_all(&mut self) -> Result<(), Failure> {
        TOPICS
            .into_iter()
            .try_for_each(|topic| self.begin(topic, || columns(topic)))
    }

    /// Starts a table if it is wanted and not started yet.
    fn begin(
        &mut self,
        topic: &'static str,
        columns: impl FnOnce() -> Vec<String>,
    ) -> Result<(), Failure> {
        if self.open.contains_key(topic) || !self.wanted.contains(&topic) {
            return Ok(());
        }
        let Some(path) = self.path(topic) else {
            let (table, begun) = Table::new(&columns(), self.format, io::stdout());
            self.open.insert(topic, table);
            return self.written(begun);
        };
        let (table, begun) = Table::new(&columns(), self.format, replace(&path)?);
        self.open.insert(topic, table);
        begun.in_file("write", &path)
    }

    /// The file of a topic; none for standard output.
    fn path(&self, topic: &str) -> Option<PathBuf> {
        Some(
            self.directory
                .as_ref()?
                .join(format!("{topic}.{}", self.format.extension())),
        )
    }

    fn fill(&mut self, reader: &mut LogReader) -> Result<(), Failure> {
        while self.is_read && reader.next_entry()?.is_some() {
            match reader.newest() {
                LogEntry::State(message) => self.write(reader, message),
                LogEntry::Setpoint(message) => self.write(reader, message),
                LogEntry::Wrench(message) => self.write(reader, message),
                LogEntry::RotorSpeeds(message) => self.write(reader, message),
                LogEntry::Swap(message) => self.write(reader, message),
                LogEntry::Theorem(message) => self.write(reader, message),
            }?;
        }
        Ok(())
    }

    /// Writes a message and the signals of its law.
    fn write<C: Logged>(
        &mut self,
        reader: &LogReader,
        message: &Message<C>,
    ) -> Result<(), Failure> {
        let format = self.format;
        self.put(<C as Topic>::NAME, || match format {
            TableFormat::Csv => rows::csv(message),
            TableFormat::Json => rows::json(message),
        })?;
        let Some((shown, telemetry)) = reader.telemetry(C::SENDER).zip(message.content.telemetry())
        else {
            return Ok(());
        };
        self.begin(shown.topic(), || shown.columns())?;
        self.put(shown.topic(), || match format {
            TableFormat::Csv => shown.csv(message.envelope.tick, telemetry),
            TableFormat::Json => shown.json(message.envelope.tick, telemetry),
        })
    }

    /// Writes a line to a table if it is wanted.
    fn put(&mut self, topic: &str, line: impl FnOnce() -> String) -> Result<(), Failure> {
        let Some(table) = self.open.get_mut(topic) else {
            return Ok(());
        };
        table.messages += 1;
        let written = writeln!(table.out, "{}", line());
        self.written(written)
    }

    fn finish(&mut self) -> Result<(), Failure> {
        let flushed = self
            .open
            .values_mut()
            .try_for_each(|table| table.out.flush());
        self.written(flushed)
    }

    /// A reader that ends early, such as `head`, is not an error.
    fn written(&mut self, written: io::Result<()>) -> Result<(), Failure> {
        match written {
            Err(e) if e.kind() == ErrorKind::BrokenPipe && self.directory.is_none() => {
                self.is_read = false;
                Ok(())
            }
            Err(e) => Err(Failure::failed(format!("cannot write the export: {e}"))),
            Ok(()) => Ok(()),
        }
    }

    /// Lists the files written; empty for standard output, which holds the messages.
    fn summary(&self) -> String {
        let line = |topic: &'static str| {
            let (messages, file) = (self.open.get(topic)?.messages, self.path(topic)?);
            Some(format!("{messages:>8} messages  {}\n", file.display()))
        };
        topics().filter_map(line).collect()
    }
}
