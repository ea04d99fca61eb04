//! `ironbird simulate`: the same four tick functions in one process, in simulated time.

use std::time::Instant;

use controller::outer::position_error_m;
use shared::messages::State;
use toml::Value;

use crate::cli::SimulateArgs;
use crate::failure::{Failure, GATE, OK, check_writable};
use crate::in_process::InProcess;
use crate::output::print;
use crate::plot::FlightPlot;
use crate::record::states::StatesWriter;
use crate::settings::Settings;

/// Simulates a flight.
///
/// # Errors
/// Usage; a file that cannot be written.
pub fn simulate(args: &SimulateArgs) -> Result<u8, Failure> {
    let mut overrides = args.flight.overrides();
    if let Some(every) = args.every {
        overrides.push(("recorder.states_every_ticks", Value::from(i64::from(every))));
    }
    let settings = Settings::resolve(args.flight.config.as_deref(), &overrides)?;
    check_writable("--states", args.states.as_deref())?;
    check_writable("--plot", args.plot.as_deref())?;
    let mut states = match &args.states {
        Some(path) => {
            let every = settings.recorder.states_every_ticks;
            Some(StatesWriter::create(path, settings.flight.period_s, every)?)
        }
        None => None,
    };
    let mut rig = InProcess::of(&settings)?;
    let start = Instant::now();
    let mut plot = args.plot.as_ref().map(|_| FlightPlot::new(settings.flight.period_s, settings.last_tick()));
    let flown = fly(&mut rig, &settings, states.as_mut(), plot.as_mut())?;
    let wall_s = start.elapsed().as_secs_f64();
    if let (Some(path), Some(plot)) = (&args.plot, &plot) {
        plot.write(path, &format!("{} with gains {}, simulated", settings.flight.trajectory, settings.flight.preset))?;
    }
    if let Some(states) = &mut states {
        states.flush()?;
    }
    print(&summary(&flown, &settings, wall_s))?;
    Ok(if flown.departure.is_none() { OK } else { GATE })
}

fn summary(flown: &Flown, settings: &Settings, wall_s: f64) -> String {
    let flown_s = flown.ticks as f64 * settings.flight.period_s;
    let mut text = format!(
        "{} with gains {}: {} ticks, {flown_s:.3} s simulated in {wall_s:.3} s ({:.0} times real time)\n",
        settings.flight.trajectory,
        settings.flight.preset,
        flown.ticks,
        flown_s / wall_s
    );
    text += &format!("position error rms {:.4} m, largest {:.4} m\n", flown.error_rms_m, flown.error_max_m);
    for (name, estimated, actual) in &flown.estimates {
        text += &format!("  {name:<24} estimated {estimated:>12.6e}  true {actual:>12.6e}\n");
    }
    if let Some(departure) = &flown.departure {
        text += &format!("{departure}\n");
    }
    let status = if flown.departure.is_none() { "PASS" } else { "FAIL" };
    text + &format!("RESULT status={status} ticks={} run=none\n", flown.ticks)
}

struct Flown {
    ticks: u64,
    error_rms_m: f64,
    error_max_m: f64,
    estimates: [(&'static str, f64, f64); 3],
    departure: Option<String>,
}

fn fly(
    rig: &mut InProcess,
    settings: &Settings,
    mut states: Option<&mut StatesWriter>,
    mut plot: Option<&mut FlightPlot>,
) -> Result<Flown, Failure> {
    let mut squares = 0.0;
    let mut flown = Flown {
        ticks: 0,
        error_rms_m: 0.0,
        error_max_m: 0.0,
        estimates: [
            ("rotor_inertia_kg_m2", 0.0, 0.0),
            ("rotational_drag_nm_s", 0.0, 0.0),
            ("disturbance_gain_rad_s2", 0.0, 0.0),
        ],
        departure: None,
    };
    for tick in 0..=settings.last_tick() {
        let record = rig.tick();
        flown.ticks += 1;
        if let Some(states) = &mut states {
            states.write(&record)?;
        }
        if let Some(plot) = &mut plot {
            plot.take(&record);
        }
        if let Some(setpoint) = &record.setpoint {
            let error_m = position_error_m(&record.state, setpoint);
            squares += error_m * error_m;
            flown.error_max_m = flown.error_max_m.max(error_m);
            if error_m > settings.flight.position_error_max_m {
                flown.departure = Some(format!(
                    "the flight left its envelope: at tick {tick} the position error is {error_m:.2} m, allowed are {} m",
                    settings.flight.position_error_max_m
                ));
            }
        }
        if let Err(departure) = rig.plant().envelope() {
            flown.departure = Some(departure.to_string());
        }
        let State { truth, .. } = record.state;
        let actual = truth.theta();
        for (i, estimate) in flown.estimates.iter_mut().enumerate() {
            (estimate.1, estimate.2) = (record.wrench.estimate[i], actual[i]);
        }
        if flown.departure.is_some() {
            break;
        }
    }
    flown.error_rms_m = (squares / flown.ticks as f64).sqrt();
    Ok(flown)
}
