//! What ran on a processor: the kernel's own trace of context switches and interrupts, in a ring of our own.
//!
//! Reading consumes what is in the ring and does not wait; the ring goes on meanwhile. Where more came than fits, the
//! kernel says so, and no thread is assumed to have run across the gap.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Read as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;

use analysis::processor_trace::{Runner, Slice};

pub const TRACEFS: &str = "/sys/kernel/tracing";

/// The ring of one processor [KiB]: some seconds of a flight.
const RING_KIB: &str = "1024";

const PIPE: &str = "trace_pipe";

/// What is traced; the last is only there on x86, where timers and other processors interrupt by vectors.
const EVENTS: [(&str, bool); 6] = [
    ("sched/sched_switch", true),
    ("irq/irq_handler_entry", true),
    ("irq/irq_handler_exit", true),
    ("irq/softirq_entry", true),
    ("irq/softirq_exit", true),
    ("irq_vectors", false),
];

#[derive(Debug)]
pub struct Trace {
    /// The events as text; reading removes them. Closed before the ring, which cannot be removed while it is open.
    pipe: File,
    ring: Ring,
    rest: Vec<u8>,
    readers: Readers,
}

impl Trace {
    /// Starts to trace a processor, or all of them, into a ring of this name.
    pub fn begin(name: &str, processor: Option<u64>) -> io::Result<Self> {
        Self::begin_at(Path::new(TRACEFS), name, processor)
    }

    fn begin_at(tracefs: &Path, name: &str, processor: Option<u64>) -> io::Result<Self> {
        let ring = Ring::new(instances(tracefs).join(name))?;
        ring.put("trace_clock", "mono")?;
        if let Some(processor) = processor {
            ring.put("tracing_cpumask", &mask(processor))?;
            ring.put(&format!("per_cpu/cpu{processor}/buffer_size_kb"), RING_KIB)?;
        } else {
            ring.put("buffer_size_kb", RING_KIB)?;
        }
        for (event, must_be_there) in EVENTS {
            let enabled = ring.put(&format!("events/{event}/enable"), "1");
            if must_be_there {
                enabled?;
            }
        }
        Ok(Self {
            pipe: ring.pipe()?,
            ring,
            rest: Vec::new(),
            readers: Readers::default(),
        })
    }

    pub fn take(&mut self) -> io::Result<Vec<Slice>> {
        if let Err(e) = self.pipe.read_to_end(&mut self.rest)
            && e.kind() != ErrorKind::WouldBlock
        {
            return Err(named(&self.ring.0.join(PIPE), &e));
        }
        let end = self.rest.iter().rposition(|byte| *byte == b'\n');
        let text: Vec<u8> = self.rest.drain(..end.map_or(0, |end| end + 1)).collect();
        Ok(self.readers.read(&String::from_utf8_lossy(&text)))
    }
}

#[derive(Debug)]
struct Ring(PathBuf);

impl Ring {
    fn new(path: PathBuf) -> io::Result<Self> {
        // One that a killed process left holds old events.
        if path.is_dir() {
            let _ = fs::remove_dir(&path);
        }
        fs::create_dir(&path).map_err(|e| named(&path, &e))?;
        Ok(Self(path))
    }

    fn put(&self, file: &str, value: &str) -> io::Result<()> {
        let path = self.0.join(file);
        fs::write(&path, value).map_err(|e| named(&path, &e))
    }

    fn pipe(&self) -> io::Result<File> {
        let path = self.0.join(PIPE);
        let flags = OFlags::NONBLOCK.bits().cast_signed();
        OpenOptions::new()
            .read(true)
            .custom_flags(flags)
            .open(&path)
            .map_err(|e| named(&path, &e))
    }
}

impl Drop for Ring {
    fn drop(&mut self) {
        let _ = self.put("tracing_on", "0");
        let _ = fs::remove_dir(&self.0);
    }
}

/// Removes the ring of a process that was killed, if there is one.
pub fn remove_left(name: &str) -> io::Result<()> {
    fs::remove_dir(instances(Path::new(TRACEFS)).join(name))
}

pub fn rings(prefix: &str) -> Vec<String> {
    let entries = fs::read_dir(instances(Path::new(TRACEFS)));
    let entries = entries.into_iter().flatten().flatten();
    entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| name.starts_with(prefix))
        .collect()
}

fn instances(tracefs: &Path) -> PathBuf {
    tracefs.join("instances")
}

fn named(path: &Path, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// A processor as the kernel's mask: hexadecimal words of 32 bits, the highest one first.
fn mask(processor: u64) -> String {
    let word = format!("{:x}", 1_u32 << (processor % 32));
    (0..processor / 32).fold(word, |mask, _| mask + ",00000000")
}

#[derive(Debug, Default)]
struct Readers(BTreeMap<String, Reader>);

impl Readers {
    /// The slices that end in the next part of a trace, in the order of their ends.
    fn read(&mut self, trace: &str) -> Vec<Slice> {
        let mut slices = Vec::new();
        for line in trace.lines() {
            // `CPU:1 [LOST 12 EVENTS]`: the ring was full.
            if line.starts_with("CPU:") && line.ends_with(" EVENTS]") {
                self.0.clear();
            } else if let Some(event) = Event::of(line) {
                let reader = self.0.entry(event.cpu.to_owned()).or_default();
                reader.take(&event, &mut slices);
            }
        }
        slices
    }
}

struct Event<'a> {
    /// Who ran: the thread's number, 0 of the idle one.
    pid: u64,
    cpu: &'a str,
    at_ns: u64,
    name: &'a str,
    fields: &'a str,
}

impl<'a> Event<'a> {
    /// `  NAME-PID     [CPU] FLAGS SECONDS.MICROSECONDS: EVENT: FIELDS`, where NAME may hold anything.
    fn of(line: &'a str) -> Option<Self> {
        line.match_indices(": ")
            .find_map(|(place, colon)| Self::at(&line[..place], &line[place + colon.len()..]))
    }

    fn at(head: &'a str, rest: &'a str) -> Option<Self> {
        let (name, fields) = rest.split_once(": ").or_else(|| rest.split_once(':'))?;
        let mut words = head.rsplit(' ').filter(|word| !word.is_empty());
        let (time, _flags, cpu) = (words.next()?, words.next()?, words.next()?);
        let pid = words.next()?.rsplit_once('-')?.1.parse().ok()?;
        let (seconds, micros) = time.split_once('.')?;
        let at_ns =
            seconds.parse::<u64>().ok()? * 1_000_000_000 + micros.parse::<u64>().ok()? * 1_000;
        Some(Self {
            pid,
            cpu: cpu.strip_prefix('[')?.strip_suffix(']')?,
            at_ns,
            name,
            fields,
        })
    }
}

#[derive(Debug, Default)]
struct Reader {
    thread: Option<(u64, u64)>,
    seen_ns: u64,
    interrupts: Vec<(Runner, u64)>,
}

impl Reader {
    fn take(&mut self, event: &Event<'_>, slices: &mut Vec<Slice>) {
        let (at_ns, name, fields) = (event.at_ns, event.name, event.fields);
        self.find(event.pid, at_ns, slices);
        self.seen_ns = at_ns;
        let slice = |from_ns, runner| Slice {
            from_ns,
            to_ns: at_ns,
            runner,
        };
        if name == "sched_switch" {
            let Some((leaves, comes)) = switch(fields) else {
                return;
            };
            // Where soft interrupts are threads (PREEMPT_RT), one may be switched out before it ends.
            self.interrupts.clear();
            let ran = self.thread.replace((comes, at_ns));
            let ran = ran.filter(|(_, from_ns)| *from_ns < at_ns);
            slices.extend(ran.map(|(_, from_ns)| slice(from_ns, leaves)));
        } else if name.ends_with("_exit") {
            let entered = self.interrupts.pop();
            slices.extend(entered.map(|(runner, from_ns)| slice(from_ns, runner)));
        } else if let Some(kind) = name.strip_suffix("_entry") {
            let name = interrupt(kind, fields);
            self.interrupts.push((Runner::Interrupt { name }, at_ns));
        }
    }

    /// Finds who runs where the switch to it was not traced: some kernels trace none from the idle thread, which ends
    /// with the interrupt that was seen in it last. After another thread its beginning is not known.
    fn find(&mut self, pid: u64, at_ns: u64, slices: &mut Vec<Slice>) {
        self.thread = match self.thread {
            Some((known, _)) if known == pid => return,
            Some((0, from_ns)) if self.seen_ns > from_ns => {
                slices.push(Slice {
                    from_ns,
                    to_ns: self.seen_ns,
                    runner: Runner::Idle,
                });
                Some((pid, self.seen_ns))
            }
            Some(_) => Some((pid, at_ns)),
            None => None,
        };
    }
}

/// `prev_comm=NAME prev_pid=PID prev_prio=N prev_state=S ==> next_comm=NAME next_pid=PID next_prio=N`: who leaves, as
/// it is by then, and the number of who comes.
fn switch(fields: &str) -> Option<(Runner, u64)> {
    let (leaves, comes) = fields.split_once(" ==> next_comm=")?;
    let (name, rest) = leaves
        .strip_prefix("prev_comm=")?
        .rsplit_once(" prev_pid=")?;
    let (pid, rest) = rest.split_once(" prev_prio=")?;
    let (pid, priority) = (pid.parse().ok()?, rest.split(' ').next()?.parse().ok()?);
    let name = name.to_owned();
    let runner = match pid {
        0 => Runner::Idle,
        pid => Runner::Thread {
            pid,
            priority,
            name,
        },
    };
    let (_, comes) = comes.rsplit_once(" next_pid=")?;
    Some((runner, comes.split(' ').next()?.parse().ok()?))
}

/// A name for an interrupt: `irq=36 name=DEVICE`, `vec=1 [action=TIMER]`, or only the kind.
fn interrupt(kind: &str, fields: &str) -> String {
    let word = |begin: &str| Some(fields.split_once(begin)?.1.trim_end_matches(']'));
    let named = match kind {
        "irq_handler" => word(" name=").map(|device| format!("irq {device}")),
        "softirq" => word("[action=").map(|action| format!("softirq {action}")),
        _ => Some(kind.replace('_', " ")),
    };
    named.unwrap_or_else(|| kind.into())
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

    fn slices(readers: &mut Readers, trace: &[&str]) -> Vec<(String, u64, u64)> {
        let slices = readers.read(&trace.join("\n"));
        let slice = |it: Slice| {
            let from_us = it.from_ns / 1000 - 100_000_000;
            (it.runner.words(), from_us, it.to_ns - it.from_ns)
        };
        slices.into_iter().map(slice).collect()
    }

    #[test]
    fn a_trace_tells_who_ran_and_what_interrupted_in_parts_and_across_gaps() {
        const INTERRUPTED: &str = "<idle>-0 [001] dNh1. 100.001480: local_timer_exit: vector=236";
        const LEAVES: &str = "hog-7 [001] d..2. 100.009000: sched_switch: prev_comm=hog prev_pid=7 prev_prio=0 prev_state=S ==> next_comm=ironbird next_pid=9 next_prio=19";
        let lines: Vec<&str> = TRACE.lines().collect();
        let [comes, goes] = [lines[2], lines[9]];
        let (thread, idle) = (("a: b-1 [2] (77)", 10, 990_000), ("idle", 1000, 500_000));
        let interrupts = [
            ("irq virtio1-req.0", 50, 3_000),
            ("local timer", 54, 7_000),
            ("softirq TIMER", 60, 4_000),
        ];
        let whole = [&interrupts[..], &[thread, idle]].concat();
        for (parts, expected) in [
            (vec![&lines[..]], whole),
            // A slice may end in the next part.
            (vec![&lines[..3], &lines[9..]], vec![thread, idle]),
            // While the ring was full, anything may have run.
            (
                vec![&lines[..3], &["CPU:1 [LOST 12 EVENTS]"], &lines[9..]],
                vec![idle],
            ),
            // After a switch that was not traced: since the last interrupt of the idle thread, or not known.
            (
                vec![&[goes, INTERRUPTED, LEAVES]],
                vec![("idle", 1000, 480_000), ("hog (7)", 1480, 7_520_000)],
            ),
            (vec![&[goes, LEAVES]], vec![]),
            (vec![&[comes, LEAVES]], vec![]),
            (vec![&["", "#", "x: y: z", ": : :"]], vec![]),
            (vec![&["a-1 [001] d 1.x: sched_switch: nothing"]], vec![]),
        ] {
            let mut readers = Readers::default();
            let read = parts.iter().flat_map(|part| slices(&mut readers, part));
            let expected = expected
                .iter()
                .map(|(name, from_us, ns)| ((*name).to_owned(), *from_us, *ns));
            assert_eq!(Vec::from_iter(read), Vec::from_iter(expected), "{parts:?}");
        }
    }

    #[test]
    fn a_trace_that_cannot_be_begun_or_read_names_the_file() {
        // No directory is read as a file.
        let mut trace = Trace {
            pipe: File::open("/").unwrap(),
            ring: Ring("/proc/self/nowhere".into()),
            rest: Vec::new(),
            readers: Readers::default(),
        };
        assert_eq!(
            trace.take().unwrap_err().to_string(),
            "/proc/self/nowhere/trace_pipe: Is a directory (os error 21)"
        );
        let error = Trace::begin_at(Path::new("/proc/self/nowhere"), "x", Some(0)).unwrap_err();
        let error = error.to_string();
        let expected = "/proc/self/nowhere/instances/x: ";
        assert!(error.starts_with(expected), "{error}");
        assert_eq!([5, 31, 32].map(mask), ["20", "80000000", "1,00000000"]);
    }
}
