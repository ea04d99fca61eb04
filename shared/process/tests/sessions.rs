//! Stations: how roles agree on t_0, and the order in which a stage lets go.

use std::fs;
use std::sync::Mutex;
use std::sync::atomic::Ordering;
use std::thread::{scope, sleep};
use std::time::Duration;

use faults::live::LoopFaults;
use ipc::DEEP;
use ipc::clock::now_ns;
use ipc::error::Error;
use ipc::instance::Instance;
use messages::blackboards::RunPhase;
use messages::content::{Stamped, State, Wrench};
use messages::flight_plan::FlightPlan;
use messages::grid::{Grid, Pace};
use messages::realtime::{LeadSetting, RealtimeMode, RealtimeSettings, RealtimeStep};
use messages::role::{Channel, ROLES, Role};
use process::rt::fifo_refusal;
use process::session::{RoleSession, StartConfig};
use process::stage::{self, Flight, Input, Stage};

use crate::common::Site;

const PLAN: FlightPlan = FlightPlan {
    last_tick: 10,
    sample_time_ns: 1_000_000,
    wall_period_ns: 1_000_000,
};

fn take(instance: &Instance, role: Role, mode: RealtimeMode) -> RoleSession {
    let config = StartConfig {
        instance: instance.clone(),
        rt: RealtimeSettings {
            mode,
            priority: 10,
            lead: LeadSetting::Fixed(0),
            rehearse: false,
            ..RealtimeSettings::OFF
        },
        settings: "flight.seed = 1\n".into(),
        law_options: String::new(),
        channel: Channel::A,
        depth: DEEP,
        launcher: None,
        begun_ns: 0,
    };
    RoleSession::take(role, config).unwrap()
}

fn grid(pace: Pace) -> Grid {
    match pace {
        Pace::Realtime(grid) => grid,
        Pace::Lockstep => panic!("the plan is of real time"),
    }
}

/// A role's run: its grid, its first tick, and when it armed: from and to [ns].
type Agreed = (Grid, u64, Vec<(u64, u64)>);

/// Arms for so long, each time.
fn arm(needs: Duration, armed_ns: &mut Vec<(u64, u64)>) -> Result<(), Error> {
    let begin_ns = now_ns();
    sleep(needs);
    armed_ns.push((begin_ns, now_ns()));
    Ok(())
}

/// What each role agrees on, the plant last, when the plant or the roles need some time to arm.
fn agree(plant_needs: Duration, role_needs: Duration) -> Vec<Agreed> {
    let site = Site::new();
    let join = |role: &Role| {
        let mut session = take(&site.instance, *role, RealtimeMode::Off);
        let mut armed_ns = Vec::new();
        let armed = session.join(|_, _, _| arm(role_needs, &mut armed_ns));
        let armed = armed.unwrap();
        (grid(armed.pace), armed.first_tick, armed_ns)
    };
    scope(|scope| {
        let spawn = |role| scope.spawn(move || join(role));
        let joining: Vec<_> = ROLES[1..].iter().map(spawn).collect();
        let mut session = take(&site.instance, Role::Plant, RealtimeMode::Off);
        let mut armed_ns = Vec::new();
        let opened = session.open_run(PLAN, |_, _, _| arm(plant_needs, &mut armed_ns));
        let plant = (grid(opened.unwrap().pace), 0, armed_ns);
        let agreed = joining.into_iter().map(|it| it.join().unwrap());
        agreed.chain([plant]).collect()
    })
}

#[test]
fn a_t_0_that_has_passed_before_all_have_armed_is_moved_for_all_and_they_arm_once() {
    let (none, late) = (Duration::ZERO, Duration::from_millis(300));
    for (plant_needs, role_needs) in [(none, none), (late, none), (none, late)] {
        let agreed = agree(plant_needs, role_needs);
        let grid = agreed[0].0;
        for (theirs, first_tick, armed_ns) in &agreed {
            assert_eq!((*theirs, *first_tick), (grid, 0));
            assert!(matches!(armed_ns[..], [(_, end_ns)] if end_ns < grid.t0_ns));
        }
        let needed_ns = (plant_needs + role_needs).as_nanos() as u64;
        assert!(grid.t0_ns > agreed[4].2[0].0 + needed_ns, "{agreed:?}");
    }
}

/// Scheduling policy of the calling thread: 0 is SCHED_OTHER, 1 is SCHED_FIFO.
fn policy() -> u32 {
    let stat = fs::read_to_string("/proc/thread-self/stat").unwrap();
    let mut fields = stat.rsplit_once(')').unwrap().1.split_whitespace();
    fields.nth(38).unwrap().parse().unwrap()
}

/// A stage that never gets an input, and notes when it is dropped, before its ports: its policy, and whether its role is
/// still locked.
struct Idle<'a> {
    instance: &'a Instance,
    dropped: &'a Mutex<Option<(u32, bool)>>,
}

impl Drop for Idle<'_> {
    fn drop(&mut self) {
        let is_locked = self.instance.is_occupied(Role::Inner);
        *self.dropped.lock().unwrap() = Some((policy(), is_locked));
    }
}

impl Stage for Idle<'_> {
    const ROLE: Role = Role::Inner;
    type Inputs = Input<State>;
    type Output = Wrench;

    fn work(&mut self, _: u64, _: &Stamped<State>) -> Option<Wrench> {
        None
    }
}

#[test]
fn a_stage_ends_real_time_before_its_ports_and_its_ports_before_its_lock() {
    for is_stopped in [false, true] {
        let (site, dropped) = (Site::new(), Mutex::new(None));
        let (instance, dropped) = (&site.instance, &dropped);
        let wait = || {
            while dropped.lock().unwrap().is_none() {
                sleep(Duration::from_millis(1));
            }
        };
        scope(|scope| {
            for role in [Role::Outer, Role::Mixer, Role::Record] {
                scope.spawn(move || {
                    let mut session = take(instance, role, RealtimeMode::Off);
                    let stop = session.stop_flag();
                    scope.spawn(move || {
                        wait();
                        stop.store(true, Ordering::Relaxed);
                    });
                    let _joined = session.join(|_, _, _| Ok(()));
                    wait();
                });
            }
            scope.spawn(move || {
                let session = take(instance, Role::Inner, RealtimeMode::Prefer);
                session.stop_flag().store(is_stopped, Ordering::Relaxed);
                let flight = Flight {
                    lockstep: false,
                    slowdown: 1,
                    faults: LoopFaults::none(0, 1_000_000),
                };
                let ended = stage::run(Idle { instance, dropped }, session, &flight);
                assert_eq!(ended.is_err(), is_stopped);
            });
            let mut session = take(instance, Role::Plant, RealtimeMode::Off);
            let stop = session.stop_flag();
            scope.spawn(move || {
                wait();
                stop.store(true, Ordering::Relaxed);
            });
            if let Ok(mut opened) = session.open_run(PLAN, |_, _, _| Ok(())) {
                let grants = opened.statuses[1].1.get().grants;
                let is_fifo = grants.of(RealtimeStep::Scheduler).granted();
                assert_eq!(is_fifo, fifo_refusal(12).is_none());
                opened.run.phase = RunPhase::Closed as u64;
                opened.blackboard.put(opened.run);
                // The blackboard is there until everybody has seen it.
                wait();
            }
        });
        assert_eq!(dropped.lock().unwrap().take(), Some((0, true)));
    }
}
