//! Findings about processors: their number, their speed, and who shares the loops'.

use crate::{Machine, cpu_list};
use report::finding::Finding;
use rustix::io::Errno;

#[must_use]
pub fn findings(machine: &Machine) -> Vec<Finding> {
    vec![
        number(machine),
        isolation(machine),
        siblings(machine),
        governor(machine),
        deep_sleep(machine),
        hypervisor(machine),
    ]
}

fn number(machine: &Machine) -> Finding {
    let allowed = machine.allowed_cpus();
    let why = "the loops share one processor, and everything else of the rig takes the others";
    let found = match allowed.len() {
        1 => "this process may use a single processor".into(),
        n => format!(
            "this process may use {n} processors; the loops take number {}",
            machine.loops_cpu()
        ),
    };
    let finding = Finding::ok("processors", found, why);
    if allowed.len() > 1 {
        finding
    } else {
        finding.could_be_better(
            "allow it another one: taskset -cp 0-1 $$, or more processors for the container",
        )
    }
}

fn isolation(machine: &Machine) -> Finding {
    let why = "on an isolated processor the scheduler puts nothing else, so nobody shares its caches and its time";
    let isolated = cpu_list(
        &machine
            .read("/sys/devices/system/cpu/isolated")
            .unwrap_or_default(),
    );
    let cpu = machine.loops_cpu();
    match isolated.first() {
        None => Finding::ok("isolation", format!("processor {cpu} is not isolated"), why).could_be_better(format!(
            "boot with isolcpus=managed_irq,domain,{cpu} nohz_full={cpu} rcu_nocbs={cpu}, and fly with --cpu {cpu}"
        )),
        Some(_) if isolated.contains(&cpu) => Finding::ok("isolation", format!("processor {cpu} is isolated"), why),
        Some(first) => {
            Finding::ok("isolation", format!("the loops take processor {cpu}, isolated are {}", listed(&isolated)), why)
                .could_be_better(format!("fly with --cpu {first}"))
        }
    }
}

fn siblings(machine: &Machine) -> Finding {
    let why =
        "a sibling thread shares the core's units and caches: whatever runs on it slows the loops";
    let cpu = machine.loops_cpu();
    let path = format!("/sys/devices/system/cpu/cpu{cpu}/topology/thread_siblings_list");
    let siblings = cpu_list(&machine.read(&path).unwrap_or_default());
    let others: Vec<usize> = siblings
        .into_iter()
        .filter(|sibling| *sibling != cpu)
        .collect();
    if others.is_empty() {
        return Finding::ok("SMT", format!("processor {cpu} has no sibling"), why);
    }
    Finding::ok(
        "SMT",
        format!("processor {cpu} shares its core with {}", listed(&others)),
        why,
    )
    .could_be_better("echo off | sudo tee /sys/devices/system/cpu/smt/control")
}

fn governor(machine: &Machine) -> Finding {
    let why = "a governor that saves energy lowers the frequency while the loops sleep, and raises it when it is late";
    let path = format!(
        "/sys/devices/system/cpu/cpu{}/cpufreq/scaling_governor",
        machine.loops_cpu()
    );
    match machine.read(&path) {
        None => Finding::ok("governor", "none: nothing here changes the frequency", why),
        Some(governor) if governor == "performance" => Finding::ok("governor", governor, why),
        Some(governor) => Finding::ok("governor", governor, why)
            .softens(format!("echo performance | sudo tee {path}")),
    }
}

/// What lets a group hold processors awake: the file's mode of the kernel is root's alone.
const DEEP_SLEEP_RULE: &str = "echo 'KERNEL==\"cpu_dma_latency\", GROUP=\"realtime\", MODE=\"0660\"' | \
    sudo tee /etc/udev/rules.d/99-cpu-dma-latency.rules; sudo groupadd -f realtime; \
    sudo usermod -aG realtime $USER; sudo udevadm control --reload; sudo udevadm trigger /dev/cpu_dma_latency; \
    log in again";

fn deep_sleep(machine: &Machine) -> Finding {
    let why = "a processor in deep sleep takes up to some 100 us to wake; a process that holds this file keeps it out";
    match machine.answers.deep_sleep_errno {
        None => Finding::ok("deep sleep", "held off by /dev/cpu_dma_latency", why),
        Some(errno) if errno == Errno::NOENT.raw_os_error() => {
            Finding::ok("deep sleep", "there is no /dev/cpu_dma_latency", why)
        }
        Some(errno) => {
            let reason = std::io::Error::from_raw_os_error(errno);
            Finding::ok(
                "deep sleep",
                format!("/dev/cpu_dma_latency is refused: {reason}"),
                why,
            )
            .could_be_better(DEEP_SLEEP_RULE)
        }
    }
}

fn hypervisor(machine: &Machine) -> Finding {
    let why = "a hypervisor takes processors away and says so later, as steal, or not at all";
    match machine.hypervisor() {
        Some(true) => Finding::ok("hypervisor", "this is a virtual machine", why).softens(
            "fly on the hardware itself; or pin the virtual processors to cores that nobody else uses \
             (libvirt: virsh vcpupin, with isolcpus on the host)",
        ),
        Some(false) => Finding::ok("hypervisor", "none", why),
        None => Finding::ok("hypervisor", "not known: neither processor nor firmware tells", why),
    }
}

fn listed(cpus: &[usize]) -> String {
    cpus.iter()
        .map(usize::to_string)
        .collect::<Vec<_>>()
        .join(", ")
}
