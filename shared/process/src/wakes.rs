//! Whom a role wakes, and on which processor it runs.
//!
//! Loops that share one processor wake each other along the chain. On 2 or 4 processors a stage is awake before its input
//! comes, and reads its event in a loop until then: so no system call lies between state and command. Role k runs on
//! processor k modulo their number. The first loop of each processor is woken by the plant's warm-up run. Each one after it is
//! woken by the loop before it on its processor, as soon as that has sent its own message.
//! docs/decisions/0031-loops-on-several-processors.md has the measurements.

use ipc::error::Error;
use ipc::{Wakes, Wire};
use messages::realtime::RealtimeSettings;
use messages::role::{Channel, Replica, Role, STAGES};

/// Place of a role's processor among those of the loops.
pub const fn place(role: Role, loop_cpus: usize) -> usize {
    role as usize % loop_cpus
}

/// Whether a role is the first of the chain on its processor.
pub const fn is_first(role: Role, loop_cpus: usize) -> bool {
    (role as usize) < loop_cpus
}

/// Whom a role wakes in its channel; the plant also wakes the other channels, when the first has its state.
pub fn wakes(
    wire: &Wire,
    replica: Replica,
    rt: &RealtimeSettings,
    lockstep: bool,
) -> Result<Wakes, Error> {
    let (role, loop_cpus) = (replica.role, rt.loop_cpus);
    let notifier = |role: &Role| wire.notifier(Replica::new(*role, replica.channel));
    let stage = |place: usize| STAGES.get(place).map(notifier).transpose();
    let receiver = match role {
        Role::Mixer => lockstep.then_some(&Role::Plant).map(notifier).transpose(),
        role => stage(role as usize + 1),
    };
    let next_here = role as usize + loop_cpus;
    let elsewhere = match role {
        Role::Plant => &STAGES[1..loop_cpus],
        _ => &[],
    };
    let rehearsals = elsewhere.iter().chain(STAGES.get(next_here));
    let mut others: Vec<_> = match loop_cpus {
        1 => Vec::new(),
        _ => stage(next_here)?.into_iter().collect(),
    };
    if role == Role::Plant {
        for channel in Channel::first(rt.channels).skip(1) {
            others.push(wire.notifier(Replica::new(Role::Outer, channel))?);
        }
    }
    Ok(Wakes {
        receiver: receiver?,
        others,
        rehearsals: rehearsals.map(notifier).collect::<Result<_, _>>()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc::instance::Instance;

    /// Places of the roles that were notified since the last call: of a message or an early wake-up, and of a warm-up run.
    fn notified(events: &[ipc::WakeEvent], rehearsals: bool) -> String {
        let is_due = |event: &ipc::WakeEvent| match rehearsals {
            true => event.rehearsal_is_due(),
            false => event.wait_until(0).unwrap(),
        };
        (0..events.len())
            .filter(|place| is_due(&events[*place]))
            .map(|place| place.to_string())
            .collect()
    }

    #[test]
    fn each_stage_is_awake_before_its_input_or_is_woken_by_it() {
        let root = tempfile::tempdir_in("/dev/shm").unwrap();
        let instance = Instance::under(root.path(), "wakes").unwrap();
        let wire = Wire::open(&instance).unwrap();
        let events = STAGES.map(|role| wire.wake_event(role).unwrap());
        // For each number of processors and each role: whom a message wakes, and whom a warm-up run.
        for (loop_cpus, by_message, by_rehearsal) in [
            (1, ["1", "2", "3", ""], ["1", "2", "3", ""]),
            (2, ["12", "23", "3", ""], ["12", "3", "", ""]),
            (4, ["1", "2", "3", ""], ["123", "", "", ""]),
        ] {
            let rt = RealtimeSettings {
                loop_cpus,
                ..RealtimeSettings::OFF
            };
            for (place, role) in STAGES.into_iter().enumerate() {
                let wakes = wakes(&wire, role.into(), &rt, false).unwrap();
                for notifier in wakes.receiver.iter().chain(&wakes.others) {
                    notifier.notify().unwrap();
                }
                let said = format!("{role} of {loop_cpus}");
                assert_eq!(notified(&events, false), by_message[place], "{said}");
                for notifier in &wakes.rehearsals {
                    notifier.notify_rehearsal().unwrap();
                }
                assert_eq!(notified(&events, true), by_rehearsal[place], "{said}");
                notified(&events, false);
            }
        }
        drop((events, wire));
        instance.remove_leftovers().unwrap();
    }
}
