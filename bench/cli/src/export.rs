//! `ironbird export`: the messages of a flight as CSV or JSON, for tools that cannot read MCAP, and the stages'
//! execution times as a Perfetto trace.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use messages::grid::Pace;
use messages::header::Message;
use messages::role::Channel;
use messages::topic::Topic;

use crate::cli::{ExportArgs, ExportFormat};
use analysis::phrase::count;
use analysis::schema::Report;
use errors::output::{print, say};
use errors::{Failure, InFile as _, OK, replace};
use flight_log::codec::Logged;
use flight_log::entry::{FORMATS, with_message};
use flight_log::perfetto::PerfettoWriter;
use flight_log::reader::{End, LogReader};
use flight_log::{perfetto, rows, topics};
use recorder::run_directory::{find_log, log_files};

pub const DIRECTORY: &str = "export";

pub fn is_ours(name: &str) -> bool {
    let topic = name.strip_suffix(".csv");
    let topic = topic.or_else(|| name.strip_suffix(".jsonl"));
    topics().any(|known| topic == Some(known))
}

pub fn export(args: &ExportArgs) -> Result<u8, Failure> {
    let path = find_log(&args.run, args.out.as_deref())?;
    let mut reader = LogReader::open(&path)?;
    let run_directory = path.parent().unwrap_or(Path::new("."));
    if matches!(args.format, ExportFormat::Perfetto) {
        if args.topic.is_some() {
            let what = "a Perfetto trace contains all stages, not one topic";
            return Err(Failure::usage(what).help("omit --topic"));
        }
        return trace(&mut reader, args.to.as_deref().unwrap_or(run_directory));
    }
    let is_json = matches!(args.format, ExportFormat::Json);
    let to = args.to.clone();
    let directory = || to.unwrap_or_else(|| run_directory.join(DIRECTORY));
    let mut tables = match &args.topic {
        // The columns of a law's signals are known once the log has been opened.
        Some(topic) => Tables::begin_all(|name| name == topic, None, is_json)?,
        None => Tables::begin_all(|_| true, Some(directory()), is_json)?,
    };
    // Everything before a damaged part is exported, then the damage is reported.
    let read = tables.fill(&mut reader).and_then(|()| tables.finish());
    print(&tables.summary())?;
    read?;
    let topic = args.topic.as_deref();
    if let Some(topic) = topic.filter(|it| tables.is_read && !tables.open.contains_key(it)) {
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

fn print_missing(reader: &LogReader) -> Result<(), Failure> {
    let Ok(kept) = reader.kept() else {
        return Ok(());
    };
    let warn = |what: String| say(&format!("{} {what}\n", reader.path().display()));
    if let Some(ticks) = kept.around_ticks {
        warn(format!(
            "contains excerpts: {ticks} ticks before and after missed deadlines, parameter changes, take-off and landing"
        ));
    }
    if kept.files_before > 0 {
        let missing = format!("earlier files missing: {}", kept.files_before);
        warn(format!("is not the first file of the log; {missing}"));
    }
    if reader.end() == End::Truncated {
        warn("is truncated; everything up to that point was exported".into());
    }
    for (topic, missing) in reader.missing()? {
        let missing = count(missing, "message");
        warn(format!(
            "lacks {missing} of topic {topic}: the disk was full"
        ));
    }
    Ok(())
}

fn trace(reader: &mut LogReader, directory: &Path) -> Result<u8, Failure> {
    create_directory(directory)?;
    let path = directory.join(perfetto::FILE);
    let file = replace(&path)?;
    // The log may have been taken away from its flight's directory.
    let report = Report::read(&reader.path().with_file_name("report.json")).ok();
    let faults = report.iter().flat_map(|it| &it.faults);
    let faults = faults.filter(|it| !it.is_cancelled()).flat_map(|it| {
        let end = it.to_tick.map(|tick| (tick, format!("{} ends", it.what)));
        [Some((it.tick, it.what.clone())), end]
            .into_iter()
            .flatten()
    });
    let out = BufWriter::new(file);
    let mut writer = PerfettoWriter::new(out, faults.collect()).in_file("write", &path)?;
    if let (Some(report), Ok(Pace::Realtime(grid))) = (&report, reader.pace()) {
        for case in report.autopsy.worst.iter().filter(|it| !it.ran.is_empty()) {
            let ran = case
                .ran
                .iter()
                .map(|it| format!("{} {:.0} us", it.who, it.us));
            let ran = ran.collect::<Vec<_>>().join(", ");
            let ends_us = [case.due_us, case.due_us + case.delay_us];
            let ends_ns = ends_us.map(|us| grid.begin_of(case.tick) + (us * 1e3) as u64);
            writer.others(ends_ns, &ran).in_file("write", &path)?;
        }
    }
    let mut read = trace_log(reader, &mut writer, &path)?;
    for channel in Channel::ALL {
        let own = reader
            .path()
            .with_file_name(flight_log::log_directory(channel));
        if let (Ok(()), Some(log)) = (&read, log_files(&own).first()) {
            writer.begin_channel(channel).in_file("write", &path)?;
            read = match LogReader::open(log) {
                Ok(mut log) => trace_log(&mut log, &mut writer, &path)?,
                Err(failure) => Err(failure),
            };
        }
    }
    writer.finish().in_file("write", &path)?;
    if writer.slices + writer.instants == 0
        && let Err(failure) = read
    {
        let _ = fs::remove_file(&path);
        return Err(failure);
    }
    let (slices, instants, path) = (writer.slices, writer.instants, path.display());
    print(&format!(
        "{slices:>8} slices, {instants} instants  {path}\n"
    ))?;
    read?;
    print_missing(reader)?;
    Ok(OK)
}

/// Adds the stages of a log to a trace. Everything before a damaged part is exported; the inner result is the damage.
fn trace_log(
    reader: &mut LogReader,
    writer: &mut PerfettoWriter<impl Write>,
    path: &Path,
) -> Result<Result<(), Failure>, Failure> {
    loop {
        match reader.next_entry() {
            Ok(Some(entry)) => writer.take(entry).in_file("write", path)?,
            Ok(None) => return Ok(Ok(())),
            Err(failure) => return Ok(Err(failure)),
        }
    }
}

fn create_directory(directory: &Path) -> Result<(), Failure> {
    create_for("export", directory, "--to")
}

/// Creates the directory that a flag names, for files that a command is about to write.
pub(crate) fn create_for(purpose: &str, directory: &Path, flag: &str) -> Result<(), Failure> {
    fs::create_dir_all(directory).map_err(|e| {
        let directory = directory.display();
        Failure::usage(format!("cannot {purpose} into {directory}: {e}"))
            .help(format!("name a writable directory: {flag} DIR"))
    })
}

struct Tables {
    is_json: bool,
    directory: Option<PathBuf>,
    selected: Vec<&'static str>,
    open: BTreeMap<&'static str, Table>,
    is_read: bool,
}

struct Table {
    out: Box<dyn Write>,
    messages: u64,
}

impl Tables {
    /// Starts the tables of some topics whose columns are known before the log is read.
    fn begin_all(
        is_selected: impl Fn(&str) -> bool,
        directory: Option<PathBuf>,
        is_json: bool,
    ) -> Result<Self, Failure> {
        directory.as_deref().map_or(Ok(()), create_directory)?;
        let mut tables = Self {
            is_json,
            directory,
            selected: topics().filter(|topic| is_selected(topic)).collect(),
            open: BTreeMap::new(),
            is_read: true,
        };
        for topic in FORMATS {
            tables.begin(topic.name, topic.columns)?;
        }
        Ok(tables)
    }

    /// Starts a table if it is selected and not started yet; writes the header line, also if no message follows.
    fn begin(
        &mut self,
        topic: &'static str,
        columns: impl FnOnce() -> Vec<String>,
    ) -> Result<(), Failure> {
        if self.open.contains_key(topic) || !self.selected.contains(&topic) {
            return Ok(());
        }
        let mut out: Box<dyn Write> = match self.path(topic) {
            Some(path) => Box::new(BufWriter::new(replace(&path)?)),
            None => Box::new(BufWriter::new(io::stdout())),
        };
        let begun = match self.is_json {
            false => writeln!(out, "{}", columns().join(",")),
            true => Ok(()),
        };
        self.open.insert(topic, Table { out, messages: 0 });
        self.written(begun)
    }

    fn path(&self, topic: &str) -> Option<PathBuf> {
        let ending = if self.is_json { "jsonl" } else { "csv" };
        Some(self.directory.as_ref()?.join(format!("{topic}.{ending}")))
    }

    fn fill(&mut self, reader: &mut LogReader) -> Result<(), Failure> {
        while self.is_read && reader.next_entry()?.is_some() {
            with_message!(reader.newest(), message => self.write(reader, message))?;
        }
        Ok(())
    }

    fn write<C: Logged>(
        &mut self,
        reader: &LogReader,
        message: &Message<C>,
    ) -> Result<(), Failure> {
        let is_json = self.is_json;
        self.put(<C as Topic>::NAME, || match is_json {
            false => rows::csv(message),
            true => rows::json(message),
        })?;
        let signals = reader.telemetry(C::SENDER);
        let Some((signals, telemetry)) = signals.zip(message.content.telemetry()) else {
            return Ok(());
        };
        self.begin(signals.topic(), || signals.columns())?;
        self.put(signals.topic(), || match is_json {
            false => signals.csv(message.envelope.tick, telemetry),
            true => signals.json(message.envelope.tick, telemetry),
        })
    }

    fn put(&mut self, topic: &str, line: impl FnOnce() -> String) -> Result<(), Failure> {
        let Some(table) = self.open.get_mut(topic) else {
            return Ok(());
        };
        table.messages += 1;
        let written = writeln!(table.out, "{}", line());
        self.written(written)
    }

    fn finish(&mut self) -> Result<(), Failure> {
        let mut tables = self.open.values_mut();
        let flushed = tables.try_for_each(|table| table.out.flush());
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
