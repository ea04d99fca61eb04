//! Stations: how the roles of a run agree on its t_0.

#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

#[allow(dead_code, reason = "the wire's tests use more of it")]
#[path = "../../wire/tests/common/mod.rs"]
mod common;

use std::sync::mpsc;
use std::thread::{scope, sleep};
use std::time::Duration;

use model::flight_plan::FlightPlan;
use model::grid::{Grid, Pace};
use model::realtime::{Mode, Settings};
use model::role::{ROLES, Role};
use role::station::{Orders, Station};
use wire::instance::Instance;

use common::Site;

const PLAN: FlightPlan = FlightPlan { last_tick: 10, sample_time_ns: 1_000_000, wall_period_ns: 1_000_000 };

fn take(instance: &Instance, role: Role) -> Station {
    let orders = Orders {
        instance: instance.clone(),
        rt: Settings { mode: Mode::Off, priority: 80, cpu: None },
        settings: "flight.seed = 1\n".into(),
        launcher: None,
    };
    Station::take(role, orders).unwrap()
}

/// The grid of each role, the plant's last, when the plant or the roles need some time to arm for the first t_0.
fn agree(plant_needs: Duration, role_needs: Duration) -> Vec<Grid> {
    let site = Site::new();
    let (tell, told) = mpsc::channel();
    let grid = |pace| match pace {
        Pace::Realtime(grid) => grid,
        Pace::Lockstep => panic!("the plan is of real time"),
    };
    scope(|scope| {
        for role in ROLES.into_iter().filter(|role| *role != Role::Plant) {
            let (tell, instance) = (tell.clone(), &site.instance);
            scope.spawn(move || {
                let mut station = take(instance, role);
                let mut needs = Some(role_needs);
                let armed = station.join(|_, _, _| {
                    sleep(needs.take().unwrap_or_default());
                    Ok(())
                });
                tell.send(grid(armed.unwrap().pace)).unwrap();
            });
        }
        let mut station = take(&site.instance, Role::Plant);
        let mut needs = Some(plant_needs);
        let opened = station.open_run(PLAN, |_, _| {
            sleep(needs.take().unwrap_or_default());
            Ok(())
        });
        let opened = opened.unwrap();
        let mut grids: Vec<Grid> = ROLES[1..].iter().map(|_| told.recv().unwrap()).collect();
        grids.push(grid(opened.pace));
        grids
    })
}

#[test]
fn a_t_0_that_has_passed_before_all_have_armed_is_moved_for_all() {
    let late = Duration::from_millis(300);
    for (plant_needs, role_needs) in [(Duration::ZERO, Duration::ZERO), (late, Duration::ZERO), (Duration::ZERO, late)]
    {
        let grids = agree(plant_needs, role_needs);
        assert_eq!(grids.len(), ROLES.len());
        assert!(grids.iter().all(|grid| *grid == grids[0]), "{plant_needs:?} {role_needs:?}: {grids:?}");
    }
}
