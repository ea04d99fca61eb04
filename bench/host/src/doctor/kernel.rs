//! Findings about the kernel: its preemption model, and its limits on SCHED_FIFO.

use messages::realtime::RealtimeStep;

use crate::executable::own_executable;
use crate::{Machine, RT_RUNTIME};
use report::finding::Finding;

#[must_use]
pub fn findings(machine: &Machine) -> Vec<Finding> {
    vec![
        preemption(machine),
        throttling(machine),
        scheduling(machine),
        cgroup(machine),
    ]
}

fn preemption(machine: &Machine) -> Finding {
    let release = machine
        .read("/proc/sys/kernel/osrelease")
        .unwrap_or_else(|| "of unknown release".into());
    let model = machine.preemption();
    let chosen = machine
        .preemption_chosen()
        .map_or_else(String::new, |chosen| format!(" set to {chosen}"));
    let finding = Finding::ok(
        "kernel",
        format!(
            "Linux {release}, {}{chosen}",
            if model == "unknown" {
                "no preemption model named"
            } else {
                model
            }
        ),
        "only PREEMPT_RT can preempt interrupt handlers and spinning locks; others hold a wake-up off until they end",
    );
    match model {
        "PREEMPT_RT" => finding,
        "PREEMPT" | "PREEMPT_DYNAMIC" => finding.softens(
            "install a kernel with CONFIG_PREEMPT_RT=y (Debian: apt install linux-image-rt-amd64); until then boot with \
             preempt=full",
        ),
        _ => finding.softens("install a kernel with CONFIG_PREEMPT_RT=y (Debian: apt install linux-image-rt-amd64)"),
    }
}

fn throttling(machine: &Machine) -> Finding {
    let why = "a SCHED_FIFO thread that uses more of its period is stopped; the loops sleep most of the time";
    let (runtime, period) = (
        machine.number(RT_RUNTIME),
        machine.number("/proc/sys/kernel/sched_rt_period_us"),
    );
    let fix = "sysctl -w kernel.sched_rt_runtime_us=950000";
    match (runtime, period) {
        (Some(0), _) => {
            Finding::ok("throttling", "SCHED_FIFO gets no time at all", why).blocks(fix)
        }
        (Some(runtime), Some(period)) if runtime > 0 && period > 0 => {
            let percent = 100 * runtime / period;
            let found = format!("SCHED_FIFO gets {percent} % of every {} ms", period / 1000);
            let finding = Finding::ok("throttling", found, why);
            if percent < 50 {
                finding.softens(fix)
            } else {
                finding
            }
        }
        (Some(_), _) => Finding::ok("throttling", "off", why),
        (None, _) => Finding::ok("throttling", "the kernel has none", why),
    }
}

/// What a shell, and its children, may ask for when the limits are raised.
pub(super) const LIMITS: &str = "printf '@realtime - rtprio 95\\n@realtime - memlock unlimited\\n' | \
    sudo tee /etc/security/limits.d/99-realtime.conf; sudo groupadd -f realtime; sudo usermod -aG realtime $USER; \
    log in again";

fn scheduling(machine: &Machine) -> Finding {
    let why = "without SCHED_FIFO every other process on the machine may run before the loops";
    let limit = machine
        .limit("Max realtime priority")
        .map_or_else(|| "unlimited".into(), |limit| limit.to_string());
    let right = if may_use_fifo(machine) {
        "CAP_SYS_NICE".into()
    } else {
        format!("RLIMIT_RTPRIO {limit}")
    };
    match machine.answers.fifo_errno {
        None => Finding::ok("scheduling", format!("SCHED_FIFO granted ({right})"), why),
        Some(errno) => {
            let reason = std::io::Error::from_raw_os_error(errno);
            let finding = Finding::ok(
                "scheduling",
                format!("SCHED_FIFO refused: {reason} ({right})"),
                why,
            );
            if may_use_fifo(machine) {
                finding.blocks(process::rt::remedy(
                    RealtimeStep::Scheduler,
                    i64::from(errno),
                ))
            } else {
                finding.blocks(format!(
                    "sudo setcap cap_sys_nice,cap_ipc_lock+ep '{}'; or {LIMITS}",
                    executable()
                ))
            }
        }
    }
}

/// The executable that asks: the one on the path may be another one, or none.
fn executable() -> String {
    own_executable().map_or_else(|_| "ironbird".into(), |path| path.display().to_string())
}

fn may_use_fifo(machine: &Machine) -> bool {
    const CAP_SYS_NICE: u32 = 23;
    machine.has_capability(CAP_SYS_NICE)
}

/// The group whose budget of real time is this process' share, where the kernel keeps such budgets.
fn cgroup(machine: &Machine) -> Finding {
    let why = "a kernel with RT_GROUP_SCHED refuses SCHED_FIFO in a cpu cgroup without a budget, even to root";
    let groups = machine.read("/proc/self/cgroup").unwrap_or_default();
    for line in groups.lines() {
        let mut parts = line.splitn(3, ':');
        let (Some(_), Some(controllers), Some(group)) = (parts.next(), parts.next(), parts.next())
        else {
            continue;
        };
        if !controllers.split(',').any(|controller| controller == "cpu") {
            continue;
        }
        let budget = [controllers, "cpu"]
            .map(|mount| {
                format!(
                    "/sys/fs/cgroup/{mount}{}/cpu.rt_runtime_us",
                    group.trim_end_matches('/')
                )
            })
            .into_iter()
            .find_map(|path| Some((machine.number(&path)?, path)));
        if let Some((budget_us, path)) = budget {
            let finding = Finding::ok(
                "rt cgroup",
                format!("{group} has {budget_us} us of real time a period"),
                why,
            );
            let fix = format!("echo 400000 | sudo tee {path}, after the same in each group above");
            return if budget_us == 0 {
                finding.blocks(fix)
            } else {
                finding
            };
        }
    }
    let unified = groups
        .lines()
        .find_map(|line| line.strip_prefix("0::"))
        .filter(|group| *group != "/");
    match (unified, machine.answers.fifo_errno) {
        (Some(group), Some(_)) if may_use_fifo(machine) => {
            let found =
                format!("SCHED_FIFO is refused in {group} although this process may have it");
            Finding::ok("rt cgroup", found, why).blocks(
                "start in the root cgroup: echo $$ | sudo tee /sys/fs/cgroup/cgroup.procs; or boot with \
                 rt_group_sched=0",
            )
        }
        _ => Finding::ok("rt cgroup", "no budget stands in the way", why),
    }
}
