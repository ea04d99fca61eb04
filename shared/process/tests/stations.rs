//! Stations: how roles agree on t_0, and the order in which a stage lets go.

use std::fs;
use std::io::Write as _;
use std::sync::atomic::Ordering;
use std::sync::{Mutex, mpsc};
use std::thread::{scope, sleep};
use std::time::Duration;

use ipc::Wire;
use ipc::clock::Horizon;
use ipc::clock::now_ns;
use ipc::error::Error;
use ipc::instance::Instance;
use messages::blackboards::{EndReason, RunPhase};
use messages::content::NO_TICK;
use messages::flight_plan::FlightPlan;
use messages::grid::{Grid, Pace};
use messages::inspection::{Expected, Rejections};
use messages::realtime::{LeadSetting, RealtimeMode, RealtimeSettings};
use messages::role::{ROLES, Role};
use process::rt::fifo_refusal;
use process::session::{RoleSession, StartConfig};
use process::stage::{self, Stage, TickContext, TickOutcome};

use crate::common::Site;

const PLAN: FlightPlan = FlightPlan {
    last_tick: 10,
    sample_time_ns: 1_000_000,
    wall_period_ns: 1_000_000,
};

fn take(instance: &Instance, role: Role, mode: RealtimeMode) -> RoleSession {
    let orders = StartConfig {
        instance: instance.clone(),
        rt: RealtimeSettings {
            mode,
            priority: 10,
            cpu: None,
            lead: LeadSetting::Fixed(0),
            rehearse: false,
        },
        settings: "flight.seed = 1\n".into(),
        law_options: String::new(),
        resume_estimates: false,
        launcher: None,
        begun_ns: 0,
        ready: None,
    };
    RoleSession::take(role, orders).unwrap()
}

fn grid(pace: Pace) -> Grid {
    match pace {
        Pace::Realtime(grid) => grid,
        Pace::Lockstep => panic!("the plan is of real time"),
    }
}

/// What a role takes from the agreement.
#[derive(Debug)]
struct Agreed {
    grid: Grid,
    first_tick: u64,
    armed_ns: Vec<(u64, u64)>,
}

/// Arms for so long the first time.
fn arm(needs: &mut Option<Duration>, armed_ns: &mut Vec<(u64, u64)>) -> Result<(), Error> {
    let begin_ns = now_ns();
    sleep(needs.take().unwrap_or_default());
    armed_ns.push((begin_ns, now_ns()));
    Ok(())
}

/// What each role takes from it, the plant last, when the plant or the roles need some time to arm for the first t_0.
fn agree(plant_needs: Duration, role_needs: Duration) -> Vec<Agreed> {
    let site = Site::new();
    let (tell, told) = mpsc::channel();
    scope(|scope| {
        for role in ROLES.into_iter().filter(|role| *role != Role::Plant) {
            let (tell, instance) = (tell.clone(), &site.instance);
            scope.spawn(move || {
                let mut station = take(instance, role, RealtimeMode::Off);
                let (mut needs, mut armed_ns) = (Some(role_needs), Vec::new());
                let armed = station
                    .join(|_, _, _| arm(&mut needs, &mut armed_ns))
                    .unwrap();
                tell.send(Agreed {
                    grid: grid(armed.pace),
                    first_tick: armed.first_tick,
                    armed_ns,
                })
                .unwrap();
            });
        }
        let mut station = take(&site.instance, Role::Plant, RealtimeMode::Off);
        let (mut needs, mut armed_ns) = (Some(plant_needs), Vec::new());
        let opened = station
            .open_run(PLAN, |_, _| arm(&mut needs, &mut armed_ns))
            .unwrap();
        let mut agreed: Vec<Agreed> = ROLES[1..].iter().map(|_| told.recv().unwrap()).collect();
        agreed.push(Agreed {
            grid: grid(opened.pace),
            first_tick: 0,
            armed_ns,
        });
        agreed
    })
}

#[test]
fn a_t_0_that_has_passed_before_all_have_armed_is_moved_for_all() {
    let late = Duration::from_millis(300);
    for (plant_needs, role_needs) in [
        (Duration::ZERO, Duration::ZERO),
        (late, Duration::ZERO),
        (Duration::ZERO, late),
    ] {
        let agreed = agree(plant_needs, role_needs);
        assert_eq!(agreed.len(), ROLES.len());
        let t0_ns = agreed[0].grid.t0_ns;
        for one in &agreed {
            assert_eq!((one.grid, one.first_tick), (agreed[0].grid, 0));
            assert!(one.armed_ns.iter().all(|(_, end_ns)| *end_ns < t0_ns));
        }
        let is_late = !(plant_needs + role_needs).is_zero();
        // The plant arms for each t_0 that it announces.
        let (first_ns, announced) = (agreed[4].armed_ns[0].0, agreed[4].armed_ns.len());
        assert!(!is_late || announced > 1, "t_0 was moved: {agreed:?}");
        assert!(!is_late || t0_ns > first_ns + 300_000_000);
    }
}

/// Scheduling policy of the calling thread: 0 is SCHED_OTHER, 1 is SCHED_FIFO.
fn policy() -> u32 {
    let stat = fs::read_to_string("/proc/thread-self/stat").unwrap();
    let after_name = stat.rsplit_once(')').unwrap().1;
    after_name
        .split_whitespace()
        .nth(38)
        .unwrap()
        .parse()
        .unwrap()
}

/// A port that sees what its stage still has when it goes.
struct Port<'a> {
    instance: &'a Instance,
    /// Policy, and whether the place was still taken.
    seen: &'a Mutex<Option<(u32, bool)>>,
}

impl Drop for Port<'_> {
    fn drop(&mut self) {
        *self.seen.lock().unwrap() = Some((policy(), self.instance.is_occupied(Role::Inner)));
    }
}

/// A stage that never gets an input.
struct Idle<'a> {
    _port: Port<'a>,
    armed: &'a Mutex<Option<u32>>,
    refuses: bool,
}

impl Stage for Idle<'_> {
    const ROLE: Role = Role::Inner;

    fn arm(&mut self, _: &Wire, _: Expected, _: u64) -> Result<(), Error> {
        *self.armed.lock().unwrap() = Some(policy());
        if self.refuses {
            Err(Error::Interrupted)
        } else {
            Ok(())
        }
    }

    fn take(&mut self, _: impl Horizon) -> Result<u64, Error> {
        Ok(NO_TICK)
    }

    fn tick(
        &mut self,
        _: &TickContext,
        _: &mut dyn FnMut(EndReason),
    ) -> Result<TickOutcome, Error> {
        Ok(TickOutcome { stale: true })
    }

    fn rehearse(&mut self, _: u64) -> Result<bool, Error> {
        Ok(false)
    }

    fn rejections(&self) -> Rejections {
        Rejections::default()
    }
}

/// Runs the idle stage through a run; gives its policy when armed, and what its port has seen at the end.
fn give_up(refuses: bool) -> (u32, (u32, bool)) {
    let site = Site::new();
    let (armed, seen) = (Mutex::new(None), Mutex::new(None));
    scope(|scope| {
        let (armed, seen, instance) = (&armed, &seen, &site.instance);
        let (tell, flags) = mpsc::channel();
        for role in [Role::Outer, Role::Mixer, Role::Record] {
            let tell = tell.clone();
            scope.spawn(move || {
                let mut station = take(instance, role, RealtimeMode::Off);
                let stop = station.stop_flag();
                tell.send(station.stop_flag()).unwrap();
                // Where it has joined, it has its place until it is told to go; else it is told while it waits.
                let _joined = station.join(|_, _, _| Ok(()));
                while !stop.load(Ordering::Relaxed) {
                    sleep(Duration::from_millis(1));
                }
            });
        }
        let inner = scope.spawn(move || {
            let station = take(instance, Role::Inner, RealtimeMode::Prefer);
            let doorbell = station.wire().doorbell(Role::Inner).unwrap();
            let ended = stage::run(
                Idle {
                    _port: Port { instance, seen },
                    armed,
                    refuses,
                },
                doorbell,
                station,
            );
            assert_eq!(ended.is_err(), refuses);
        });
        let mut station = take(instance, Role::Plant, RealtimeMode::Off);
        // Where the stage ends instead of arming, nobody would wait for the plant any more.
        let stop = station.stop_flag();
        scope.spawn(move || {
            while refuses && !inner.is_finished() {
                sleep(Duration::from_millis(1));
            }
            stop.store(refuses, Ordering::Relaxed);
        });
        if let Ok(mut opened) = station.open_run(PLAN, |_, _| Ok(())) {
            opened.run.phase = RunPhase::Closed as u64;
            opened.board.put(opened.run);
            // The board is there until everybody has seen it.
            while seen.lock().unwrap().is_none() {
                sleep(Duration::from_millis(1));
            }
        }
        flags
            .iter()
            .take(3)
            .for_each(|stop| stop.store(true, Ordering::Relaxed));
    });
    (
        armed.into_inner().unwrap().unwrap(),
        seen.into_inner().unwrap().unwrap(),
    )
}

#[test]
fn a_stage_gives_up_real_time_before_its_ports_and_its_ports_before_its_place() {
    for refuses in [false, true] {
        let (armed, seen) = give_up(refuses);
        if fifo_refusal(12).is_none() {
            assert_eq!(armed, 1, "SCHED_FIFO is granted here");
        } else {
            let _ = writeln!(
                std::io::stderr().lock(),
                "NOT TESTED: this user is refused SCHED_FIFO"
            );
        }
        // Policy, and whether the place is taken, when the ports go.
        assert_eq!(seen, (0, true));
    }
}
