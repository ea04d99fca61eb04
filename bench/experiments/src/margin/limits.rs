//! When faults begin, and the bounds of the limits.

use std::time::Duration;

use analysis::comparison::SETTLING_S;
use analysis::margin::Bounds;
use analysis::phrase::count;

use config::Settings;
use errors::Failure;

/// For a trajectory that does not repeat: the span in which faults begin [s].
const NO_CYCLE_S: f64 = 10.0;
/// The longest time until a flight must be back on its trajectory [s].
const SURVIVAL_MAX_S: f64 = 600.0;

#[derive(Clone, Debug, PartialEq)]
pub struct Phases {
    /// First ticks of the faults, ascending; at least one.
    pub ticks: Vec<u64>,
    /// Span of the trajectory that they cover [s].
    pub span_s: f64,
    /// Period of the trajectory [s].
    pub cycle_s: Option<f64>,
}

impl Phases {
    /// From the end of the trajectory's ramp and of the flight's settling time, over one period.
    pub fn new(
        phases: u32,
        duration: Option<Duration>,
        settings: &Settings,
    ) -> Result<Self, Failure> {
        let course = settings.course()?;
        let (period_s, number) = (settings.flight.period_s, f64::from(phases));
        let first_s = course.begun_s() + SETTLING_S;
        let rest_s = course.end_s().map(|end_s| end_s - first_s);
        let cycle_s = course.cycle_s();
        let whole_s = cycle_s.or(rest_s.filter(|rest_s| *rest_s > 0.0));
        let mut span_s = whole_s.unwrap_or(NO_CYCLE_S);
        let duration_s = duration.map(|duration| duration.as_secs_f64());
        if let Some(duration_s) = duration_s {
            span_s = span_s.min(duration_s - first_s);
        }
        if span_s < number * period_s {
            let phases = count(u64::from(phases), "phase");
            let Some(duration_s) = duration_s else {
                let what = format!(
                    "there is no room for {phases} in the {span_s} s over which faults are spread"
                );
                let most = (span_s / period_s).floor();
                let help =
                    format!("use at most --phases {most}: one for each tick of {period_s} s");
                return Err(Failure::usage(what).help(help));
            };
            return Err(Failure::usage(format!(
                "--duration {duration_s}s is too short for {phases}: faults begin at {first_s} s, after the \
                 trajectory's ramp and the settling time"
            ))
            .help("fly longer, or leave --duration out to cover one period of the trajectory"));
        }
        let tick = |i: u32| ((first_s + span_s * f64::from(i) / number) / period_s).round() as u64;
        Ok(Self {
            ticks: (0..phases).map(tick).collect(),
            span_s,
            cycle_s,
        })
    }
}

/// A bound of the limits, by its name in `--gate`.
pub type BoundName = (&'static str, fn(&mut Bounds) -> &mut f64);

pub const BOUNDS: [BoundName; 7] = [
    ("unnoticed_below_m", |it| &mut it.unnoticed_below_m),
    ("unnoticed_yaw_below_rad", |it| {
        &mut it.unnoticed_yaw_below_rad
    }),
    ("recovered_below_m", |it| &mut it.recovered_below_m),
    ("recovered_yaw_below_rad", |it| {
        &mut it.recovered_yaw_below_rad
    }),
    ("recovery_max_s", |it| &mut it.recovery_max_s),
    ("survival_max_s", |it| &mut it.survival_max_s),
    ("rate_step_increase_rad_s", |it| {
        &mut it.rate_step_increase_rad_s
    }),
];

/// The defaults, with what was given on the command line.
pub fn bounds(given: &[(BoundName, f64)], settings: &Settings) -> Result<Bounds, Failure> {
    let mut bounds = Bounds {
        unnoticed_below_m: 0.02,
        unnoticed_yaw_below_rad: 0.02,
        recovered_below_m: settings.flight.tracking_error_max_m,
        recovered_yaw_below_rad: settings.flight.tracking_yaw_error_max_rad,
        recovery_max_s: 5.0,
        survival_max_s: 20.0,
        rate_step_increase_rad_s: 1e-4,
    };
    for (i, ((name, bound), most)) in given.iter().enumerate() {
        if given[..i].iter().any(|((other, _), _)| other == name) {
            let what = format!("--gate {name} is given twice");
            return Err(Failure::usage(what).help("give each bound once"));
        }
        *bound(&mut bounds) = *most;
    }
    let (recovery_s, survival_s) = (bounds.recovery_max_s, bounds.survival_max_s);
    if survival_s > SURVIVAL_MAX_S {
        let what = format!(
            "--gate survival_max_s={survival_s}: allowed are 0 to {SURVIVAL_MAX_S}: each flight lasts as long"
        );
        return Err(Failure::usage(what).help("name a shorter time, in s"));
    }
    if recovery_s > survival_s {
        let is_given = given.iter().any(|((name, _), _)| *name == "recovery_max_s");
        let (what, other) = match is_given {
            true => (
                format!(
                    "--gate recovery_max_s={recovery_s}: allowed are 0 to survival_max_s, {survival_s}"
                ),
                "survival_max_s",
            ),
            false => (
                format!(
                    "--gate survival_max_s={survival_s}: allowed are {recovery_s} (recovery_max_s) to {SURVIVAL_MAX_S}"
                ),
                "recovery_max_s",
            ),
        };
        return Err(Failure::usage(what).help(format!("set {other}, too")));
    }
    Ok(bounds)
}
