//! What ran on a processor: the kernel's own trace of context switches and interrupts, in a ring of our own.
//!
//! Reading stops the ring, takes what is in it, empties it and starts it again; what runs meanwhile is not seen.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use report::autopsy::runners::{Runner, Slice};

/// Where the kernel has its traces.
pub const TRACEFS: &str = "/sys/kernel/tracing";

/// The ring of one processor [KiB]: some seconds of a flight.
const RING_KIB: &str = "1024";

/// What is traced; the last is only there on x86, where timers and other processors interrupt by vectors.
const EVENTS: [(&str, bool); 6] = [
    ("sched/sched_switch", true),
    ("irq/irq_handler_entry", true),
    ("irq/irq_handler_exit", true),
    ("irq/softirq_entry", true),
    ("irq/softirq_exit", true),
    ("irq_vectors", false),
];

/// A ring of the kernel's trace, removed with the value.
#[derive(Debug)]
pub struct Trace {
    ring: PathBuf,
    readers: Readers,
}

impl Trace {
    /// Starts to trace a processor, or all of them, into a ring of this name.
    ///
    /// # Errors
    /// What the kernel refuses, with the file that it refuses.
    pub fn begin(name: &str, processor: Option<u64>) -> io::Result<Self> {
        Self::begin_at(Path::new(TRACEFS), name, processor)
    }

    fn begin_at(tracefs: &Path, name: &str, processor: Option<u64>) -> io::Result<Self> {
        let ring = ring(tracefs, name);
        // One that a killed process left holds old events.
        if ring.is_dir() {
            let _ = fs::remove_dir(&ring);
        }
        fs::create_dir(&ring).map_err(|e| named(&ring, &e))?;
        let trace = Self { ring, readers: Readers::default() };
        trace.put("trace_clock", "mono")?;
        if let Some(processor) = processor {
            trace.put("tracing_cpumask", &mask(processor))?;
            trace.put(&format!("per_cpu/cpu{processor}/buffer_size_kb"), RING_KIB)?;
        } else {
            trace.put("buffer_size_kb", RING_KIB)?;
        }
        for (event, must_be_there) in EVENTS {
            let enabled = trace.put(&format!("events/{event}/enable"), "1");
            if must_be_there {
                enabled?;
            }
        }
        Ok(trace)
    }

    /// Whether a ring can be made here; nothing is left of it.
    ///
    /// # Errors
    /// What the kernel refuses, with the file that it refuses.
    pub fn try_here() -> io::Result<()> {
        Self::begin(&format!("ironbird-try-{}", std::process::id()), None).map(drop)
    }

    /// What ran since the last time.
    ///
    /// # Errors
    /// What the kernel refuses, with the file that it refuses.
    pub fn take(&mut self) -> io::Result<Vec<Slice>> {
        self.put("tracing_on", "0")?;
        let path = self.ring.join("trace");
        let text = fs::read(&path).map_err(|e| named(&path, &e))?;
        self.put("trace", "")?;
        self.put("tracing_on", "1")?;
        Ok(self.readers.read(&String::from_utf8_lossy(&text)))
    }

    fn put(&self, file: &str, value: &str) -> io::Result<()> {
        let path = self.ring.join(file);
        // Opened to be truncated: that is what empties a ring.
        fs::write(&path, value).map_err(|e| named(&path, &e))
    }
}

impl Drop for Trace {
    fn drop(&mut self) {
        let _ = self.put("tracing_on", "0");
        let _ = fs::remove_dir(&self.ring);
    }
}

/// Removes the ring of a process that was killed; says which, where there was one.
pub fn remove_left(name: &str) -> Option<PathBuf> {
    let ring = ring(Path::new(TRACEFS), name);
    fs::remove_dir(&ring).is_ok().then_some(ring)
}

fn ring(tracefs: &Path, name: &str) -> PathBuf {
    tracefs.join("instances").join(name)
}

fn named(path: &Path, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// A processor as the kernel's mask: hexadecimal words of 32 bits, the highest one first.
fn mask(processor: u64) -> String {
    let word = format!("{:x}", 1_u32 << (processor % 32));
    (0..processor / 32).fold(word, |mask, _| mask + ",00000000")
}

/// Follows the processors of a trace, by their names in it.
#[derive(Debug, Default)]
struct Readers(BTreeMap<String, Reader>);

impl Readers {
    /// The slices that end in the next part of a trace, in the order of their ends.
    fn read(&mut self, trace: &str) -> Vec<Slice> {
        let events = trace.lines().filter_map(Event::of);
        events.filter_map(|event| self.0.entry(event.cpu.to_owned()).or_default().take(&event)).collect()
    }
}

/// A line of the trace.
struct Event<'a> {
    cpu: &'a str,
    at_ns: u64,
    name: &'a str,
    fields: &'a str,
}

impl<'a> Event<'a> {
    /// `  NAME-PID     [CPU] FLAGS SECONDS.MICROSECONDS: EVENT: FIELDS`, where NAME may hold anything.
    fn of(line: &'a str) -> Option<Self> {
        line.match_indices(": ").find_map(|(place, colon)| Self::at(&line[..place], &line[place + colon.len()..]))
    }

    fn at(head: &'a str, rest: &'a str) -> Option<Self> {
        let (name, fields) = rest.split_once(": ").or_else(|| rest.split_once(':'))?;
        let mut words = head.rsplit(' ').filter(|word| !word.is_empty());
        let (time, _flags, cpu) = (words.next()?, words.next()?, words.next()?);
        let (seconds, micros) = time.split_once('.')?;
        let at_ns = seconds.parse::<u64>().ok()? * 1_000_000_000 + micros.parse::<u64>().ok()? * 1_000;
        Some(Self { cpu: cpu.strip_prefix('[')?.strip_suffix(']')?, at_ns, name, fields })
    }
}

/// Follows a processor.
#[derive(Debug, Default)]
struct Reader {
    /// The number of who runs, since when.
    thread: Option<(u64, u64)>,
    /// What interrupts it, since when.
    interrupts: Vec<(Runner, u64)>,
}

impl Reader {
    fn take(&mut self, event: &Event<'_>) -> Option<Slice> {
        let Event { at_ns, name, fields, .. } = *event;
        if name == "sched_switch" {
            let (leaves, comes) = switch(fields)?;
            let (pid, from_ns) = self.thread.replace((comes, at_ns))?;
            // Between two parts of a trace, others may have run.
            return (leaves.pid() == pid).then_some(Slice { from_ns, to_ns: at_ns, runner: leaves });
        }
        if name.ends_with("_exit") {
            let (runner, from_ns) = self.interrupts.pop()?;
            return Some(Slice { from_ns, to_ns: at_ns, runner });
        }
        if let Some(kind) = name.strip_suffix("_entry") {
            self.interrupts.push((Runner::Interrupt { name: interrupt(kind, fields) }, at_ns));
        }
        None
    }
}

/// `prev_comm=NAME prev_pid=PID prev_prio=N prev_state=S ==> next_comm=NAME next_pid=PID next_prio=N`: who leaves, as
/// it is by then, and the number of who comes.
fn switch(fields: &str) -> Option<(Runner, u64)> {
    let (leaves, comes) = fields.split_once(" ==> next_comm=")?;
    let (name, rest) = leaves.strip_prefix("prev_comm=")?.rsplit_once(" prev_pid=")?;
    let (pid, rest) = rest.split_once(" prev_prio=")?;
    let (pid, priority) = (pid.parse().ok()?, rest.split(' ').next()?.parse().ok()?);
    let runner = if pid == 0 { Runner::Idle } else { Runner::Thread { pid, priority, name: name.into() } };
    let (_, comes) = comes.rsplit_once(" next_pid=")?;
    Some((runner, comes.split(' ').next()?.parse().ok()?))
}

/// A name for an interrupt: `irq=36 name=DEVICE`, `vec=1 [action=TIMER]`, or only the kind.
fn interrupt(kind: &str, fields: &str) -> String {
    let word = |begin: &str| Some(fields.split_once(begin)?.1.trim_end_matches(']'));
    match kind {
        "irq_handler" => word(" name=").map_or_else(|| kind.into(), |device| format!("irq {device}")),
        "softirq" => word("[action=").map_or_else(|| kind.into(), |action| format!("softirq {action}")),
        _ => kind.replace('_', " "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines as a kernel 6.18 writes them, with a name that holds everything that stands around it.
    const TRACE: &str = "\
# tracer: nop
#
     rcu_preempt-15      [001] d..2. 100.000010: sched_switch: prev_comm=rcu_preempt prev_pid=15 prev_prio=120 prev_state=I ==> next_comm=a: b-1 [2] next_pid=77 next_prio=120
       a: b-1 [2]-77     [001] d.h.. 100.000050: irq_handler_entry: irq=36 name=virtio1-req.0
       a: b-1 [2]-77     [001] d.h.. 100.000053: irq_handler_exit: irq=36 ret=handled
          <idle>-0       [000] d.h.. 100.000054: local_timer_entry: vector=236
       a: b-1 [2]-77     [001] ..s.. 100.000060: softirq_entry: vec=1 [action=TIMER]
          <idle>-0       [000] d.h.. 100.000061: local_timer_exit: vector=236
       a: b-1 [2]-77     [001] ..s.. 100.000064: softirq_exit: vec=1 [action=TIMER]
       a: b-1 [2]-77     [001] d..2. 100.001000: sched_switch: prev_comm=a: b-1 [2] prev_pid=77 prev_prio=120 prev_state=R ==> next_comm=swapper/1 next_pid=0 next_prio=120
          <idle>-0       [001] d..2. 100.001500: sched_switch: prev_comm=swapper/1 prev_pid=0 prev_prio=120 prev_state=R ==> next_comm=ironbird next_pid=9 next_prio=19
";

    #[test]
    fn a_trace_tells_who_ran_and_what_interrupted() {
        let told: Vec<(String, u64, u64)> = Readers::default()
            .read(TRACE)
            .into_iter()
            .map(|it| (it.runner.words(), it.from_ns / 1000 - 100_000_000, it.to_ns - it.from_ns))
            .collect();
        let expected = [
            ("irq virtio1-req.0", 50, 3_000),
            ("local timer", 54, 7_000),
            ("softirq TIMER", 60, 4_000),
            ("a: b-1 [2] (77)", 10, 990_000),
            ("idle", 1000, 500_000),
        ];
        assert_eq!(told, expected.map(|(name, from_us, ns)| (name.to_owned(), from_us, ns)));
    }

    #[test]
    fn a_slice_may_end_in_the_next_part() {
        let lines: Vec<&str> = TRACE.lines().collect();
        let mut readers = Readers::default();
        assert_eq!(readers.read(&lines[..3].join("\n")), []);
        let rest = readers.read(&lines[9..].join("\n"));
        assert_eq!(rest.iter().map(|it| it.runner.words()).collect::<Vec<_>>(), ["a: b-1 [2] (77)", "idle"]);
        // Here somebody else ran in between, and nobody knows since when.
        let mut readers = Readers::default();
        readers.read(&lines[..3].join("\n"));
        assert_eq!(readers.read(lines[10]), []);
    }

    #[test]
    fn what_is_no_trace_has_no_slices() {
        for text in ["", "\n#\n", "x: y: z", "a-1 [001] d 1.x: sched_switch: nothing", ": : :"] {
            assert_eq!(Readers::default().read(text), []);
        }
    }

    #[test]
    fn a_processor_is_a_bit_of_a_word() {
        assert_eq!([0, 5, 31, 32, 65].map(mask), ["1", "20", "80000000", "1,00000000", "2,00000000,00000000"]);
    }

    #[test]
    fn a_refusal_names_the_file() {
        let error = Trace::begin_at(Path::new("/proc/self/nowhere"), "x", Some(0)).unwrap_err();
        assert!(error.to_string().starts_with("/proc/self/nowhere/instances/x: "), "{error}");
    }
}
