//! `ironbird export`: the messages of a flight as tables, by topic or joined by tick, and the stages' execution times as a
//! Perfetto trace.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, BufWriter, ErrorKind};
use std::path::{Path, PathBuf};

use messages::content::{NO_TICK, RotorSpeeds, Setpoint, State, Wrench};
use messages::grid::Pace;
use messages::header::Message;
use messages::role::Channel;
use messages::telemetry::LAW_ROLES;
use messages::topic::Topic;

use crate::cli::ExportArgs;
use crate::table_file::{TableFile, TableFormat};
use analysis::phrase::{count, list};
use analysis::schema::Report;
use analysis::states::{Joined, Joiner};
use analysis::tracking::Tracking;
use errors::output::{print, say};
use errors::{AsideFile, Failure, InFile as _, OK};
use flight_log::codec::Logged;
use flight_log::entry::{FORMATS, LogEntry, with_message};
use flight_log::facts::SETTINGS;
use flight_log::perfetto::PerfettoWriter;
use flight_log::reader::{End, LogReader};
use flight_log::rows::{Cell, Column};
use flight_log::telemetry::TelemetryTopic;
use flight_log::{perfetto, rows, topics};
use recorder::run_directory::{find_log, log_files};
use replay::log_check::settings_of;

pub const DIRECTORY: &str = "export";

const JOINED: &str = "joined";

pub fn is_ours(name: &str) -> bool {
    let ending =
        |(_, ending): &(&str, &str)| TableFormat::ALL.iter().any(|it| it.ending() == *ending);
    let table = name.split_once('.').filter(ending);
    table.is_some_and(|(table, _)| topics().chain([JOINED]).any(|known| table == known))
}

pub fn export(args: &ExportArgs) -> Result<u8, Failure> {
    let path = find_log(&args.run, args.out.as_deref())?;
    let mut reader = LogReader::open(&path)?;
    let run_directory = path.parent().unwrap_or(Path::new("."));
    let Some(format) = args.format.table() else {
        if args.topic.is_some() || args.joined {
            let what = "a Perfetto trace contains all stages, not one topic or table";
            return Err(Failure::usage(what).help("omit --topic and --joined"));
        }
        return trace(&mut reader, args.to.as_deref().unwrap_or(run_directory));
    };
    let to = args.to.clone();
    let directory = to.unwrap_or_else(|| run_directory.join(DIRECTORY));
    if args.joined {
        return export_joined(&mut reader, format, &directory);
    }
    let mut tables = match &args.topic {
        // The columns of a law's signals are known once the log has been opened.
        Some(topic) => Tables::begin_all(|name| name == topic, None, format)?,
        None => Tables::begin_all(|_| true, Some(directory), format)?,
    };
    // Everything before a damaged part is exported, then the damage is reported.
    let read = tables.fill(&mut reader)?;
    tables.finish()?;
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
    create_for("export", directory, "--to")?;
    let path = directory.join(perfetto::FILE);
    let file = AsideFile::create(&path).in_file("write", &path)?;
    let report = reader.path().with_file_name("report.json");
    let report = match Report::read(&report) {
        Ok(report) => Some(report),
        // The log may have been taken away from its flight's directory.
        Err(_) if !report.exists() => None,
        Err(failure) => {
            say(&failure
                .append("; the faults of the flight are left out")
                .warning());
            None
        }
    };
    let faults = report.iter().flat_map(|it| &it.faults);
    let faults = faults.filter(|it| it.acted()).flat_map(|it| {
        let end = it.to_tick.map(|tick| (tick, format!("{} ends", it.what)));
        [Some((it.tick, it.what.clone())), end]
            .into_iter()
            .flatten()
    });
    let out = BufWriter::new(file.file().in_file("write", &path)?);
    let pace = reader.pace().ok();
    let mut writer = PerfettoWriter::new(out, faults.collect(), pace).in_file("write", &path)?;
    if let (Some(report), Some(Pace::Realtime(grid))) = (&report, pace) {
        for case in report.autopsy.worst.iter().filter(|it| !it.ran.is_empty()) {
            let ends_us = [case.due_us, case.due_us + case.delay_us];
            let ends_ns = ends_us.map(|us| grid.begin_of(case.tick) + (us * 1e3) as u64);
            writer
                .others(ends_ns, &list(&case.ran))
                .in_file("write", &path)?;
        }
    }
    let trace = |writer: &mut PerfettoWriter<_>, log: &mut LogReader| {
        for_each_entry(log, |log| {
            writer.take(log.newest()).in_file("write", &path)?;
            Ok(true)
        })
    };
    let mut read = trace(&mut writer, reader)?;
    for channel in Channel::ALL {
        let own = reader
            .path()
            .with_file_name(flight_log::log_directory(channel));
        if let (Ok(()), Some(log)) = (&read, log_files(&own).first()) {
            writer.begin_channel(channel).in_file("write", &path)?;
            read = match LogReader::open(log) {
                Ok(mut log) => trace(&mut writer, &mut log)?,
                Err(failure) => Err(failure),
            };
        }
    }
    writer.finish().in_file("write", &path)?;
    if writer.slices + writer.instants == 0
        && let Err(failure) = read
    {
        return Err(failure);
    }
    file.keep().in_file("write", &path)?;
    let (slices, instants, path) = (writer.slices, writer.instants, path.display());
    print(&format!(
        "{slices:>8} slices, {instants} instants  {path}\n"
    ))?;
    read?;
    print_missing(reader)?;
    Ok(OK)
}

/// Reads a log while `take` wants more of it. Everything before a damaged part is exported; the inner result is the damage.
fn for_each_entry(
    reader: &mut LogReader,
    mut take: impl FnMut(&LogReader) -> Result<bool, Failure>,
) -> Result<Result<(), Failure>, Failure> {
    loop {
        match reader.next_entry().map(|entry| entry.is_some()) {
            Ok(true) if take(reader)? => {}
            Ok(_) => return Ok(Ok(())),
            Err(damage) => return Ok(Err(damage)),
        }
    }
}

/// Creates the directory that a flag names, for files that a command is about to write.
pub(crate) fn create_for(purpose: &str, directory: &Path, flag: &str) -> Result<(), Failure> {
    fs::create_dir_all(directory).map_err(|e| {
        let directory = directory.display();
        Failure::usage(format!("cannot {purpose} into {directory}: {e}"))
            .help(format!("name a writable directory: {flag} DIR"))
    })
}

/// Length of a tick, as the flight's settings have it [s].
fn period_s(reader: &LogReader) -> Result<f64, Failure> {
    let text = reader.fact(SETTINGS, "settings.toml")?;
    let settings = text.parse::<toml::Table>().ok();
    let period_s = settings.and_then(|it| it.get("flight")?.get("period_s")?.as_float());
    period_s.ok_or_else(|| reader.damaged("its settings have no flight.period_s"))
}

/// The time of a tick on the flight's axis [s].
fn time(tick: u64, period_s: f64) -> Cell {
    match tick {
        NO_TICK => Cell::Missing,
        tick => Cell::Number(tick as f64 * period_s),
    }
}

fn with_time(columns: Vec<Column>) -> Vec<Column> {
    let time = std::iter::once(Column::number("t_s", "s"));
    time.chain(columns).collect()
}

fn with_tick(columns: Vec<Column>) -> Vec<Column> {
    let tick = Column {
        name: "tick".into(),
        unit: "tick".into(),
        is_number: false,
    };
    with_time(std::iter::once(tick).chain(columns).collect())
}

/// Writes the table of all topics of the loop.
fn export_joined(
    reader: &mut LogReader,
    format: TableFormat,
    directory: &Path,
) -> Result<u8, Failure> {
    create_for("export", directory, "--to")?;
    let path = directory.join(format!("{JOINED}.{}", format.ending()));
    // Before the first message, the log does not say what the laws show.
    let first = reader.next_entry()?.copied();
    let (shape, period_s) = (JoinedShape::of(reader), period_s(reader)?);
    let columns = with_tick(shape.columns.clone());
    let mut table = TableFile::create(format, &path, columns).in_file("write", &path)?;
    let mut joiner = Joiner::default();
    let mut write = |joined: Joined| {
        let begin = [time(joined.tick, period_s), Cell::Integer(joined.tick)];
        let row: Vec<Cell> = begin.into_iter().chain(shape.cells(&joined)).collect();
        table.push(&row).in_file("write", &path)
    };
    let mut chunks = reader.chunks;
    let mut take = |entry: &LogEntry, chunk| {
        // Within a chunk messages are in the order of their topics, not of their ticks.
        if std::mem::replace(&mut chunks, chunk) != chunk {
            while let Some(joined) = joiner.next_complete() {
                write(joined)?;
            }
        }
        joiner.take(entry);
        Ok::<_, Failure>(true)
    };
    first.map_or(Ok(true), |entry| take(&entry, reader.chunks))?;
    let read = for_each_entry(reader, |reader| take(reader.newest(), reader.chunks))?;
    while let Some(joined) = joiner.rest() {
        write(joined)?;
    }
    table.finish().in_file("write", &path)?;
    print(&format!("{:>8} rows  {}\n", table.rows, path.display()))?;
    // Everything before a damaged part is exported, then the damage is reported.
    read?;
    print_missing(reader)?;
    Ok(OK)
}

/// The columns of the joined table. They have the names of the arrays in Python: `state`, `truth`, `setpoint`, `reference`,
/// `wrench`, `rotor_speeds` and `telemetry.ROLE`.
struct JoinedShape {
    columns: Vec<Column>,
    /// Which numbers of the messages have a column: all but the plant's record for the replay.
    is_kept: Vec<bool>,
    signals: [Option<TelemetryTopic>; LAW_ROLES.len()],
    /// The reference of ticks without a setpoint; none where the log does not say what was flown.
    tracking: Option<Tracking>,
}

impl JoinedShape {
    fn of(reader: &LogReader) -> Self {
        let content = [
            named_in::<State>(),
            named_in::<Setpoint>(),
            named_in::<Wrench>(),
            named_in::<RotorSpeeds>(),
        ]
        .concat();
        let is_kept = content.iter().map(Option::is_some).collect();
        let mut columns: Vec<Column> = content.into_iter().flatten().collect();
        let signals = LAW_ROLES.map(|role| reader.telemetry(role).cloned());
        for (role, signals) in LAW_ROLES.iter().zip(&signals) {
            let of_law = signals.iter().flat_map(TelemetryTopic::columns);
            columns.extend(of_law.map(|column| Column {
                name: format!("telemetry.{role}.{}", column.name),
                ..column
            }));
        }
        let flown = settings_of(reader).and_then(|settings| {
            let course = settings.course()?;
            Ok(Tracking::along(course, settings.flight.period_s))
        });
        Self {
            columns,
            is_kept,
            signals,
            tracking: flown.ok(),
        }
    }

    /// The numbers of a setpoint; where there is none, those of its reference.
    fn setpoint(&self, joined: &Joined) -> Vec<Cell> {
        let (Some(tracking), None) = (&self.tracking, &joined.setpoint) else {
            return cells_of(joined.setpoint.as_ref());
        };
        let reference = tracking.reference(joined.tick, &joined.state);
        let cells = rows::content_cells(&Setpoint {
            reference,
            ..Setpoint::default()
        });
        let columns = rows::content_columns::<Setpoint>().into_iter();
        let cells = columns.zip(cells).map(|(column, cell)| {
            let is_of_reference = column.name.starts_with("reference.");
            if is_of_reference { cell } else { Cell::Missing }
        });
        cells.collect()
    }

    fn cells(&self, joined: &Joined) -> impl Iterator<Item = Cell> {
        let content = [
            rows::content_cells(&joined.state),
            self.setpoint(joined),
            cells_of(joined.wrench.as_ref()),
            cells_of(joined.rotor_speeds.as_ref()),
        ]
        .concat();
        let content = content.into_iter().zip(&self.is_kept);
        let telemetry = self.signals.iter().zip(joined.telemetry());
        let telemetry = telemetry.flat_map(|(signals, shown)| {
            let signals = signals.iter();
            signals.flat_map(move |signals| match shown {
                Some(shown) => signals.cells(shown),
                None => vec![Cell::Missing; signals.columns().len()],
            })
        });
        let kept = content.filter_map(|(cell, is_kept)| is_kept.then_some(cell));
        kept.chain(telemetry)
    }
}

/// The columns of a topic as the joined table has them; none for a number that it leaves out.
fn named_in<C: Logged>() -> Vec<Option<Column>> {
    let named = |column: Column| {
        let path = column.name.split_once('.').map_or("", |(path, _)| path);
        let name = match path {
            "decision" | "target" => return None,
            // The setpoint has it, too.
            "reference" if C::NAME == State::NAME => return None,
            "truth" | "reference" => column.name,
            _ => format!(
                "{}.{}",
                C::NAME,
                column.name.trim_start_matches("measured.")
            ),
        };
        Some(Column { name, ..column })
    };
    let columns = rows::content_columns::<C>().into_iter();
    columns.map(named).collect()
}

fn cells_of<C: Logged>(content: Option<&C>) -> Vec<Cell> {
    content.map_or_else(
        || vec![Cell::Missing; rows::content_columns::<C>().len()],
        rows::content_cells,
    )
}

struct Tables {
    format: TableFormat,
    directory: Option<PathBuf>,
    selected: Vec<&'static str>,
    open: BTreeMap<&'static str, TableFile>,
    /// Length of a tick [s], from the first message on.
    period_s: Option<f64>,
    is_read: bool,
}

impl Tables {
    /// Starts the tables of some topics whose columns are known before the log is read.
    fn begin_all(
        is_selected: impl Fn(&str) -> bool,
        directory: Option<PathBuf>,
        format: TableFormat,
    ) -> Result<Self, Failure> {
        if let Some(directory) = &directory {
            create_for("export", directory, "--to")?;
        }
        let mut tables = Self {
            format,
            directory,
            selected: topics().filter(|topic| is_selected(topic)).collect(),
            open: BTreeMap::new(),
            period_s: None,
            is_read: true,
        };
        for topic in FORMATS {
            tables.begin(topic.name, || with_time((topic.columns)()))?;
        }
        Ok(tables)
    }

    /// Starts a table if it is selected and not started yet.
    fn begin(
        &mut self,
        topic: &'static str,
        columns: impl FnOnce() -> Vec<Column>,
    ) -> Result<(), Failure> {
        if self.open.contains_key(topic) || !self.selected.contains(&topic) {
            return Ok(());
        }
        let begun = match self.path(topic) {
            Some(path) => TableFile::create(self.format, &path, columns()),
            None => {
                let out = Box::new(BufWriter::new(io::stdout()));
                TableFile::begin(self.format, out, columns())
            }
        };
        let begun = begun.map(|table| drop(self.open.insert(topic, table)));
        self.written(topic, begun)
    }

    fn path(&self, topic: &str) -> Option<PathBuf> {
        let ending = self.format.ending();
        Some(self.directory.as_ref()?.join(format!("{topic}.{ending}")))
    }

    /// Takes the messages of a log; the inner result is its damage.
    fn fill(&mut self, reader: &mut LogReader) -> Result<Result<(), Failure>, Failure> {
        for_each_entry(reader, |reader| {
            with_message!(reader.newest(), message => self.write(reader, message))?;
            Ok(self.is_read)
        })
    }

    fn write<C: Logged>(
        &mut self,
        reader: &LogReader,
        message: &Message<C>,
    ) -> Result<(), Failure> {
        let period_s = match self.period_s {
            Some(period_s) => period_s,
            None => *self.period_s.insert(period_s(reader)?),
        };
        let tick = message.envelope.tick;
        let begin = time(tick, period_s);
        self.put(<C as Topic>::NAME, [begin], || rows::cells(message))?;
        let signals = reader.telemetry(C::SENDER);
        let Some((signals, telemetry)) = signals.zip(message.content.telemetry()) else {
            return Ok(());
        };
        self.begin(signals.topic(), || with_tick(signals.columns()))?;
        let begin = [begin, Cell::Integer(tick)];
        self.put(signals.topic(), begin, || signals.cells(telemetry))
    }

    fn put<const N: usize>(
        &mut self,
        topic: &str,
        begin: [Cell; N],
        rest: impl FnOnce() -> Vec<Cell>,
    ) -> Result<(), Failure> {
        let Some(table) = self.open.get_mut(topic) else {
            return Ok(());
        };
        let row: Vec<Cell> = begin.into_iter().chain(rest()).collect();
        let written = table.push(&row);
        self.written(topic, written)
    }

    fn finish(&mut self) -> Result<(), Failure> {
        let topics: Vec<&str> = self.open.keys().copied().collect();
        topics.into_iter().try_for_each(|topic| {
            let finished = self.open.get_mut(topic).map_or(Ok(()), TableFile::finish);
            self.written(topic, finished)
        })
    }

    /// A reader that ends early, such as `head`, is not an error.
    fn written(&mut self, topic: &str, written: io::Result<()>) -> Result<(), Failure> {
        match self.path(topic) {
            Some(path) => written.in_file("write", &path),
            None => match written {
                Err(e) if e.kind() == ErrorKind::BrokenPipe => {
                    self.is_read = false;
                    Ok(())
                }
                written => written
                    .map_err(|e| Failure::failed(format!("cannot write to standard output: {e}"))),
            },
        }
    }

    /// Lists the files written; empty for standard output, which holds the messages.
    fn summary(&self) -> String {
        let line = |topic: &'static str| {
            let (messages, file) = (self.open.get(topic)?.rows, self.path(topic)?);
            Some(format!("{messages:>8} messages  {}\n", file.display()))
        };
        topics().filter_map(line).collect()
    }
}
