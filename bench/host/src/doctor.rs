//! `ironbird doctor`: can this machine fly in real time, and if not, why not?
//!
//! `CHECKS` is the table of what is examined; each check is a pure function of a [`Machine`]. The measured part is
//! added on request. The worst finding decides the verdict.

pub mod measured;
mod other_programs;
mod reasons;

use std::io;

use analysis::finding::{Diagnosis, Finding, Level, RealtimeClass};
use analysis::host::{Host, InterruptCount, InterruptKind};
use analysis::phrase::{count, name_of};
use ipc::instance::SHARED_MEMORY;
use ipc::{DEEP, Wire};
use messages::realtime::RealtimeStep;
use process::rt::{WITHOUT_ROOT, remedy};
use rustix::io::Errno;
use serde::{Deserialize, Serialize};

use crate::cpu_times::{CpuTimes, host_of};
use crate::interrupts::Interrupts;
use crate::{CLOCK_SOURCE, Machine, RT_RUNTIME, cpu_list, own_executable};
use measured::MeasuredMachine;
pub use reasons::reason;
use reasons::{MakeFinding, steal_finding};

/// Version of the schema of `doctor --json`: changed whenever a key changes its meaning or goes.
pub const SCHEMA: &str = "ironbird-doctor/1";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Examination {
    pub schema: String,
    pub diagnosis: Diagnosis,
    pub findings: Vec<Finding>,
    pub measured: Option<MeasuredMachine>,
    pub host: Host,
}

type Check = fn(&Machine, MakeFinding) -> Finding;

const CHECKS: [(&str, Check); 19] = [
    ("kernel", preemption),
    ("throttling", throttling),
    ("scheduling", scheduling),
    ("rt cgroup", cgroup),
    ("processor quota", |machine, found| {
        container_limit(machine, found, "cpu", 1.0)
    }),
    ("processors", processors),
    ("isolation", isolation),
    ("SMT", siblings),
    ("interrupts", interrupts),
    ("governor", governor),
    ("deep sleep", deep_sleep),
    ("hypervisor", hypervisor),
    ("clock", clock),
    ("timers", timers),
    ("memory lock", memory_lock),
    ("memory limit", |machine, found| {
        container_limit(machine, found, "memory", 128.0)
    }),
    ("shared memory", shared_memory),
    ("leftovers", leftovers),
    ("steal since boot", |machine, found| {
        let since_boot = CpuTimes::default().steal_until(&CpuTimes::of(machine, None));
        steal_finding(&since_boot, found)
    }),
];

pub fn findings(machine: &Machine) -> Vec<Finding> {
    let checked = CHECKS.iter().map(|(subject, check)| {
        let why = reason(subject);
        check(machine, &|found| Finding::ok(subject, found, why))
    });
    checked.chain(switches(machine)).collect()
}

/// Examines a machine; `others` are findings of those who have measured more.
pub fn examine(
    machine: &Machine,
    measured: Option<MeasuredMachine>,
    others: Vec<Finding>,
) -> Examination {
    let mut findings = findings(machine);
    // Not in the table: during a flight, the flight's own processes run on that CPU.
    findings.push(other_programs::finding(machine));
    findings.extend(measured.iter().flat_map(MeasuredMachine::findings));
    findings.extend(others);
    Examination {
        schema: SCHEMA.into(),
        diagnosis: Diagnosis::of(&findings),
        findings,
        measured,
        host: host_of(machine),
    }
}

fn preemption(machine: &Machine, found: MakeFinding) -> Finding {
    let release = machine.read("/proc/sys/kernel/osrelease");
    let release = release.unwrap_or_else(|| "of unknown release".into());
    let chosen = machine.preemption_chosen();
    let chosen = chosen.map_or_else(String::new, |chosen| format!(" set to {chosen}"));
    let install =
        "install a kernel with CONFIG_PREEMPT_RT=y (Debian: apt install linux-image-rt-amd64)";
    let model = machine.preemption();
    let named = match model {
        "unknown" => "no preemption model named",
        model => model,
    };
    let finding = found(&format!("Linux {release}, {named}{chosen}"));
    match model {
        "PREEMPT_RT" => finding,
        "unknown" => finding.softens(install),
        _ => finding.softens(format!("{install}; until then boot with preempt=full")),
    }
}

fn throttling(machine: &Machine, found: MakeFinding) -> Finding {
    let fix = "sysctl -w kernel.sched_rt_runtime_us=950000";
    let period_us = machine.number("/proc/sys/kernel/sched_rt_period_us");
    match (machine.number(RT_RUNTIME), period_us) {
        (Some(0), _) => found("SCHED_FIFO gets no time at all").blocks(fix),
        (Some(runtime_us), Some(period_us)) if runtime_us > 0 && period_us > 0 => {
            let (percent, period_ms) = (100 * runtime_us / period_us, period_us / 1000);
            let finding = found(&format!(
                "SCHED_FIFO gets {percent} % of every {period_ms} ms"
            ));
            if percent < 50 {
                finding.softens(fix)
            } else {
                finding
            }
        }
        (Some(_), _) => found("off"),
        (None, _) => found("the kernel has none"),
    }
}

const RAISE_LIMITS: &str = "printf '@realtime - rtprio 95\\n@realtime - memlock unlimited\\n' | \
    sudo tee /etc/security/limits.d/99-realtime.conf; sudo groupadd -f realtime; sudo usermod -aG realtime $USER; \
    log in again";

fn scheduling(machine: &Machine, found: MakeFinding) -> Finding {
    let right = if may_use_fifo(machine) {
        "CAP_SYS_NICE".into()
    } else {
        let limit = machine.limit("Max realtime priority");
        let limit = limit.map_or_else(|| "unlimited".into(), |limit| limit.to_string());
        format!("RLIMIT_RTPRIO {limit}")
    };
    let Some(errno) = machine.answers.fifo_errno else {
        return found(&format!("SCHED_FIFO granted ({right})"));
    };
    let reason = io::Error::from_raw_os_error(errno);
    let finding = found(&format!("SCHED_FIFO refused: {reason} ({right})"));
    if may_use_fifo(machine) {
        return finding.blocks(remedy(RealtimeStep::Scheduler, i64::from(errno)));
    }
    // The executable on the path may be another one, or none.
    let executable = own_executable();
    let executable = executable.map_or_else(|_| "ironbird".into(), |it| it.display().to_string());
    finding.blocks(format!(
        "sudo setcap cap_sys_nice,cap_ipc_lock+ep '{executable}'; or {RAISE_LIMITS}"
    ))
}

fn may_use_fifo(machine: &Machine) -> bool {
    const CAP_SYS_NICE: u32 = 23;
    machine.has_capability(CAP_SYS_NICE)
}

/// The real-time budget of this process's cpu cgroup, where the kernel keeps such budgets.
fn cgroup(machine: &Machine, found: MakeFinding) -> Finding {
    let files = machine.groups("self", "cpu").into_iter();
    let files = files.map(|group| format!("{group}/cpu.rt_runtime_us"));
    let mut budgets = files.filter_map(|file| Some((machine.number(&file)?, file)));
    match budgets.next() {
        Some((0, file)) => found(&format!("no real time: {file}")).blocks(format!(
            "echo 400000 | sudo tee {file}, after the same in each group above"
        )),
        // -1 is no limit.
        Some((us, file)) => found(&format!("{us} us of real time a period: {file}")),
        None => found("no cgroup budget limits SCHED_FIFO"),
    }
}

/// A limit of this process's container; `needed` is the least with which a flight with one channel can do.
fn container_limit(
    machine: &Machine,
    found: MakeFinding,
    controller: &str,
    needed: f64,
) -> Finding {
    let Some((limit, file)) = machine.group_limit("self", controller) else {
        return found("none");
    };
    let is_quota = controller == "cpu";
    let unit = if is_quota { "processors" } else { "MiB" };
    let none = if file.ends_with(".max") { "max" } else { "-1" };
    let finding = found(&format!(
        "{limit:.2} {unit}, a flight needs {needed}: {file}"
    ));
    let fix = format!(
        "echo {none} | sudo tee {file} (docker: docker update --cpus 2 --memory 512m CONTAINER)"
    );
    // No quota stops the loops under SCHED_FIFO.
    let is_bearable = is_quota && machine.answers.fifo_errno.is_none();
    match limit < needed {
        true if is_bearable => finding.could_be_better(fix),
        true => finding.blocks(fix),
        false => finding,
    }
}

fn processors(machine: &Machine, found: MakeFinding) -> Finding {
    let (count, cpu) = (machine.allowed_cpus().len(), machine.loops_cpu());
    if count > 1 {
        return found(&format!(
            "this process may use {count} processors; the loops take number {cpu}"
        ));
    }
    let fix = "allow it another one: taskset -cp 0-1 $$, or more processors for the container";
    found("this process may use a single processor").could_be_better(fix)
}

fn isolation(machine: &Machine, found: MakeFinding) -> Finding {
    let isolated = machine.read("/sys/devices/system/cpu/isolated");
    let isolated = cpu_list(&isolated.unwrap_or_default());
    let cpu = machine.loops_cpu();
    match isolated.first() {
        None => found(&format!("processor {cpu} is not isolated")).could_be_better(format!(
            "boot with isolcpus=managed_irq,domain,{cpu} nohz_full={cpu} rcu_nocbs={cpu}, and fly with --cpu {cpu}"
        )),
        Some(_) if isolated.contains(&cpu) => found(&format!("processor {cpu} is isolated")),
        Some(first) => found(&format!(
            "the loops take processor {cpu}, isolated are {}",
            listed(&isolated)
        ))
        .could_be_better(format!("fly with --cpu {first}")),
    }
}

fn siblings(machine: &Machine, found: MakeFinding) -> Finding {
    let cpu = machine.loops_cpu();
    let path = format!("/sys/devices/system/cpu/cpu{cpu}/topology/thread_siblings_list");
    let mut siblings = cpu_list(&machine.read(&path).unwrap_or_default());
    siblings.retain(|sibling| *sibling != cpu);
    if siblings.is_empty() {
        return found(&format!("processor {cpu} has no sibling"));
    }
    let siblings = listed(&siblings);
    found(&format!("processor {cpu} shares its core with {siblings}"))
        .could_be_better("echo off | sudo tee /sys/devices/system/cpu/smt/control")
}

fn listed(cpus: &[usize]) -> String {
    let cpus: Vec<String> = cpus.iter().map(usize::to_string).collect();
    cpus.join(",")
}

/// The devices that interrupt, and may do so on the loops' processor.
fn interrupts(machine: &Machine, found: MakeFinding) -> Finding {
    let cpu = machine.loops_cpu();
    let is_allowed = |it: &InterruptCount| {
        let cpus = machine.read(&format!("/proc/irq/{}/smp_affinity_list", it.name));
        it.kind == InterruptKind::Hard && cpu_list(&cpus.unwrap_or_default()).contains(&cpu)
    };
    let mut devices = Interrupts::default().until(&Interrupts::of(machine, None));
    devices.retain(is_allowed);
    let mut others = machine.allowed_cpus();
    others.retain(|other| *other != cpu);
    let Some(most) = devices.first().filter(|_| !others.is_empty()) else {
        return found(&format!("processor {cpu} has none that could be moved"));
    };
    let often = format!("{} {} ({} so far)", most.name, most.source, most.count);
    let numbers: Vec<&str> = devices.iter().map(|it| &*it.name).collect();
    let (numbers, others) = (numbers.join(" "), listed(&others));
    let all = count(devices.len() as u64, "device");
    found(&format!(
        "{all} may take processor {cpu}, most often {often}"
    ))
    .could_be_better(format!(
        "for i in {numbers}; do echo {others} | sudo tee /proc/irq/$i/smp_affinity_list; done"
    ))
}

/// Settings of the kernel that stop processes now and then: subject, file, how the file begins if all is well, remedy.
const SWITCHES: &str = include_str!("doctor/switches.txt");

fn switches(machine: &Machine) -> impl Iterator<Item = Finding> {
    SWITCHES.lines().filter_map(|line| {
        let [subject, file, good, fix] = line.splitn(4, " | ").collect::<Vec<_>>()[..] else {
            return None;
        };
        let value = machine.read(file);
        let found = value.as_deref().unwrap_or("the kernel has none");
        let finding = Finding::ok(subject, found, reason(subject));
        Some(match value.is_some_and(|value| !value.starts_with(good)) {
            true => finding.could_be_better(fix),
            false => finding,
        })
    })
}

fn governor(machine: &Machine, found: MakeFinding) -> Finding {
    let cpu = machine.loops_cpu();
    let path = format!("/sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor");
    match machine.read(&path).as_deref() {
        None => found("none: nothing here changes the frequency"),
        Some("performance") => found("performance"),
        Some(governor) => found(governor).softens(format!("echo performance | sudo tee {path}")),
    }
}

/// Lets a group hold processors awake: the kernel makes the file for root alone.
const DEEP_SLEEP_RULE: &str = "echo 'KERNEL==\"cpu_dma_latency\", GROUP=\"realtime\", MODE=\"0660\"' | \
    sudo tee /etc/udev/rules.d/99-cpu-dma-latency.rules; sudo groupadd -f realtime; \
    sudo usermod -aG realtime $USER; sudo udevadm control --reload; sudo udevadm trigger /dev/cpu_dma_latency; \
    log in again";

fn deep_sleep(machine: &Machine, found: MakeFinding) -> Finding {
    match machine.answers.deep_sleep_errno {
        None => found("held off by /dev/cpu_dma_latency"),
        Some(errno) if errno == Errno::NOENT.raw_os_error() => {
            found("there is no /dev/cpu_dma_latency")
        }
        Some(errno) => {
            let why = io::Error::from_raw_os_error(errno);
            found(&format!("/dev/cpu_dma_latency is refused: {why}"))
                .could_be_better(DEEP_SLEEP_RULE)
        }
    }
}

fn hypervisor(machine: &Machine, found: MakeFinding) -> Finding {
    match machine.hypervisor() {
        Some(true) => found("this is a virtual machine").softens(
            "fly on the hardware itself; or pin the virtual processors to cores that nothing else uses \
             (libvirt: virsh vcpupin, with isolcpus on the host)",
        ),
        Some(false) => found("none"),
        None => found("neither the processor nor the firmware says").unknown(RealtimeClass::Hard),
    }
}

fn clock(machine: &Machine, found: MakeFinding) -> Finding {
    let available = machine
        .read("/sys/devices/system/clocksource/clocksource0/available_clocksource")
        .unwrap_or_default();
    let fix = if available.split(' ').any(|other| other == "tsc") {
        format!("echo tsc | sudo tee {CLOCK_SOURCE}")
    } else {
        "boot with tsc=reliable, where the processor's counter is constant (constant_tsc, nonstop_tsc)".into()
    };
    let source = machine.clock_source();
    match source.as_str() {
        "jiffies" | "refined-jiffies" => found(&source).blocks(fix),
        "hpet" | "acpi_pm" | "pit" => found(&source).softens(fix),
        "unknown" => found("the kernel names no clock source").unknown(RealtimeClass::Hard),
        _ => found(&source),
    }
}

fn timers(machine: &Machine, found: MakeFinding) -> Finding {
    let resolution_ns = machine.answers.timer_resolution_ns;
    let finding = found(&format!("resolution {resolution_ns} ns"));
    // A timer without high resolution has that of the scheduler's tick: at best a millisecond.
    if resolution_ns < 100_000 {
        finding
    } else {
        finding.blocks("boot a kernel with CONFIG_HIGH_RES_TIMERS=y, without highres=off")
    }
}

/// What the role with most memory locks [bytes]: address space, which is what the limit counts.
const LOCKED_BYTES: u64 = 192 << 20;
const MIB: u64 = 1 << 20;

fn memory_lock(machine: &Machine, found: MakeFinding) -> Finding {
    const CAP_IPC_LOCK: u32 = 14;
    if machine.has_capability(CAP_IPC_LOCK) {
        return found("without limit (CAP_IPC_LOCK)");
    }
    let Some(limit) = machine.limit("Max locked memory") else {
        return found("RLIMIT_MEMLOCK unlimited");
    };
    let limited = format!("RLIMIT_MEMLOCK {} MiB", limit / MIB);
    if limit >= LOCKED_BYTES {
        return found(&limited);
    }
    let needed = LOCKED_BYTES / MIB;
    found(&format!("{limited}, a loop needs up to {needed} MiB")).softens(RAISE_LIMITS)
}

fn shared_memory(machine: &Machine, found: MakeFinding) -> Finding {
    let (path, needed) = (SHARED_MEMORY, Wire::needed_bytes(1, DEEP));
    let Some(free) = machine.answers.shared_memory_free_bytes else {
        return found(&format!("{path} is not there"))
            .blocks(format!("sudo mount -t tmpfs -o size=256M tmpfs {path}"));
    };
    let (free_mib, needed_mib) = (free / MIB, needed.div_ceil(MIB));
    let finding = found(&format!(
        "{free_mib} MiB free in {path}, a flight needs {needed_mib}"
    ));
    if free >= needed {
        return finding;
    }
    finding.blocks(format!(
        "sudo mount -o remount,size=256M {path} (docker: --shm-size 256m)"
    ))
}

fn leftovers(machine: &Machine, found: MakeFinding) -> Finding {
    let leftovers = &machine.answers.leftovers;
    let Some(first) = leftovers.first() else {
        return found("none");
    };
    let more = match leftovers.len() {
        1 => String::new(),
        all => format!(" and {} more", all - 1),
    };
    found(&format!("{}{more}", first.display())).could_be_better("ironbird clean")
}

pub fn render(examination: &Examination) -> String {
    let mut text = String::new();
    for finding in &examination.findings {
        let (level, subject) = (name_of(&finding.level), &finding.subject);
        text += &format!("{level:<8} {subject:<17} {}\n", finding.found);
        if finding.level != Level::Ok {
            text += &format!("{:>13}  {}\n", "why", finding.why);
            let fix = finding.fix.iter();
            text.extend(fix.map(|fix| format!("{:>13}  {fix}\n", "fix")));
        }
    }
    text.extend(examination.measured.iter().map(MeasuredMachine::text));
    let Diagnosis { verdict, reasons } = &examination.diagnosis;
    text += &format!("\nVERDICT {}\n", name_of(verdict));
    text.extend(reasons.iter().map(|reason| format!("  {reason}\n")));
    if *verdict == RealtimeClass::NotRealTime {
        text += &format!("  {WITHOUT_ROOT}\n");
    }
    text
}
