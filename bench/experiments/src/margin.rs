//! Robustness margins: flights with growing outages, delays and message loss, to find what a loop survives.
//!
//! Each flight is one of `ironbird simulate` with a `--fault` and the seed of its phase. All phases fly the same strengths
//! in rounds, and all limits are judged by the same flights. The result does not depend on the number of CPUs. Start
//! reading in [`measure_all`].

pub mod flights;
pub mod limits;
pub mod prediction;
pub mod search;
pub mod table;
pub mod target;

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use analysis::margin::{
    Bounds, Kind, LawMargins, Margins, Point, Prediction, SCHEMA, SURVIVES, Search,
};
use analysis::phrase::name_of;
use analysis::recovery::RecoveryBounds;
use config::Settings;
use errors::{Failure, GATE};
use flight_log::build;
use messages::parameters::Airframe;

use crate::combinations;
use crate::parallel::on_processors;
use crate::progress::Progress;
use flights::Flights;
use limits::Phases;
use prediction::predicted;
use search::{Question, SPARSE, asked, left, next, questions};
use target::Target;

#[derive(Clone, Debug)]
pub struct Task {
    pub targets: Vec<Target>,
    pub bounds: Bounds,
    /// Longest outage to try [ticks].
    pub longest: u64,
    /// Number of threads.
    pub jobs: usize,
}

pub fn measure_all(
    settings: &[Settings],
    phases: &Phases,
    task: &Task,
    stop: &AtomicBool,
) -> Result<Margins, Failure> {
    let first = &settings[0];
    let (bounds, airframe) = (task.bounds, first.airframe()?);
    let (questions, searches): (Vec<_>, Vec<_>) = questions(&task.targets, task.longest, &airframe)
        .into_iter()
        .unzip();
    let survey = Survey {
        settings,
        phases,
        task,
        stop,
        questions,
        airframe,
    };
    let cells = survey.cells(0)?;
    let mut laws = Vec::new();
    for (law, settings) in settings.iter().enumerate() {
        let own = cells.iter().filter(|cell| cell.law == law);
        let unfaulted = own.map(|cell| cell.flights().unfaulted);
        let unfaulted = unfaulted.reduce(Point::worse).unwrap_or_default();
        laws.push(LawMargins {
            laws: combinations::laws(settings)?,
            preset: settings.flight.preset.clone(),
            fingerprint: table::fingerprint(settings)?,
            unfaulted,
            qualified: bounds.qualified(&unfaulted),
            searches: searches.clone(),
            predicted: Prediction::default(),
            flights: 0,
        });
    }
    if searches.iter().any(|search| search.kind == Kind::Gain) {
        let loops = on_processors(settings, task.jobs, |it| predicted(it, stop), |_| ())?;
        let laws = laws.iter_mut().zip(loops);
        laws.for_each(|(law, loops)| law.predicted = loops);
    }
    let mut margins = Margins {
        schema: SCHEMA.into(),
        build: build::executable(),
        trajectory: first.trajectory_name().into(),
        airframe: first.airframe_name().into(),
        preset: combinations::preset(settings).into(),
        seed: first.flight.seed,
        period_s: first.flight.period_s,
        phases_s: phases
            .ticks
            .iter()
            .map(|tick| *tick as f64 * first.flight.period_s)
            .collect(),
        span_s: phases.span_s,
        cycle_s: phases.cycle_s,
        longest_ticks: task.longest,
        sparse: SPARSE,
        bounds,
        laws,
    };
    check(&margins)?;
    survey.search(&mut margins.laws, &cells)?;
    survey.repeat(&mut margins.laws)?;
    Ok(margins)
}

/// Refuses to go on if no law flies well enough without a fault.
fn check(margins: &Margins) -> Result<(), Failure> {
    if margins.laws.iter().any(|law| law.qualified[SURVIVES]) {
        return Ok(());
    }
    let why = margins.laws.iter().map(|law| {
        let why = match law.unfaulted.peak_m {
            Some(peak_m) => {
                let yaw_rad = law.unfaulted.peak_yaw_rad.unwrap_or_default();
                format!("its position error is {peak_m:.4} m, its yaw error {yaw_rad:.4} rad")
            }
            None => format!("its flight is lost ({})", name_of(&law.unfaulted.cause)),
        };
        format!("{}: {why}", margins.name_of(&law.laws))
    });
    let RecoveryBounds {
        position_m,
        yaw_rad,
    } = margins.bounds.recovered();
    Err(Failure::new(
        GATE,
        format!(
            "no law keeps its envelope, {position_m} m and {yaw_rad} rad of yaw without a fault; {}",
            why.collect::<Vec<_>>().join("; ")
        ),
    )
    .help("choose other laws, another trajectory or preset, or a wider bound such as --gate recovered_below_m=0.2"))
}

struct Survey<'a> {
    settings: &'a [Settings],
    phases: &'a Phases,
    task: &'a Task,
    stop: &'a AtomicBool,
    questions: Vec<Question>,
    airframe: Airframe,
}

/// Flights of one combination of laws from one phase on, for some of the questions.
struct Cell<'a> {
    law: usize,
    questions: Vec<usize>,
    flights: Mutex<Flights<'a>>,
}

impl<'a> Cell<'a> {
    fn flights(&self) -> MutexGuard<'_, Flights<'a>> {
        self.flights.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Survey<'_> {
    /// Phase i has the flight's seed plus `seed` and i. Questions are spread over as many cells as there are threads.
    fn cells(&self, seed: usize) -> Result<Vec<Cell<'_>>, Failure> {
        let (number, groups) = (
            self.phases.ticks.len(),
            self.task.jobs.min(self.questions.len()),
        );
        let places: Vec<usize> = (0..self.settings.len() * number * groups).collect();
        let cell = |place: &usize| {
            let (law, phase, group) = (
                place / groups / number,
                place / groups % number,
                place % groups,
            );
            let mut settings = self.settings[law].clone();
            let flight = &mut settings.flight;
            flight.seed = flight.seed.wrapping_add((seed + phase) as u64);
            let from = self.phases.ticks[phase];
            let flights = Flights::new(&settings, self.task.bounds, from, self.stop)?;
            Ok(Cell {
                law,
                questions: (group..self.questions.len())
                    .step_by(groups)
                    .filter(|i| self.questions[*i].is_of(phase))
                    .collect(),
                flights: Mutex::new(flights),
            })
        };
        on_processors(&places, self.task.jobs, cell, |_| ())
    }

    /// Flies the strengths that each law and question wants; gives each cell's points with their questions.
    fn fly(
        &self,
        cells: &[Cell<'_>],
        wanted: &[Vec<Vec<u64>>],
        look: impl FnMut(usize),
        flown: &AtomicU64,
    ) -> Result<Vec<Vec<(usize, Point)>>, Failure> {
        let tick_ns = self.settings[0].sample_time_ns();
        let work = |cell: &Cell<'_>| {
            let flights = cell.flights();
            let mut points = Vec::new();
            for i in &cell.questions {
                let question = &self.questions[*i];
                for at in &wanted[cell.law][*i] {
                    let fault = question.fault(*at, flights.from, tick_ns, &self.airframe);
                    points.push((*i, flights.fly(*at, fault, question.ticks(*at))?));
                    flown.fetch_add(1, Ordering::Relaxed);
                }
            }
            Ok(points)
        };
        on_processors(cells, self.task.jobs, work, look)
    }

    /// Flies in rounds: the flights of one say which strengths the next one needs.
    fn search(&self, laws: &mut [LawMargins], cells: &[Cell<'_>]) -> Result<(), Failure> {
        let (bounds, flown) = (&self.task.bounds, AtomicU64::new(0));
        let phases = |question: &Question| {
            let phases = 0..self.phases.ticks.len();
            phases.filter(|phase| question.is_of(*phase)).count() as u64
        };
        let expected = |laws: &[LawMargins]| {
            let of = |law: &LawMargins| -> u64 {
                let searches = law.searches.iter().zip(&self.questions);
                let flights = |(search, question): (&Search, &Question)| {
                    left(search, law.qualified, bounds) * phases(question)
                };
                searches.map(flights).sum()
            };
            flown.load(Ordering::Relaxed) + laws.iter().map(of).sum::<u64>()
        };
        let mut total = expected(laws);
        let mut progress = Progress::new(total, "flight");
        loop {
            let wanted = each(laws, |law, it| next(it, law.qualified, bounds));
            if wanted.iter().flatten().all(Vec::is_empty) {
                break;
            }
            let look = |_| progress.look(flown.load(Ordering::Relaxed));
            let results = self.fly(cells, &wanted, look, &flown)?;
            for (cell, points) in cells.iter().zip(results) {
                let law = &mut laws[cell.law];
                law.flights += points.len() as u64;
                points
                    .into_iter()
                    .for_each(|(i, point)| law.searches[i].take(point));
            }
            let fewer = total.saturating_sub(expected(laws));
            total -= fewer;
            progress.skip(fewer);
        }
        progress.clear();
        for law in laws {
            for search in &mut law.searches {
                let asked = asked(search, law.qualified);
                let limit = |it: usize| asked[it].then(|| search.greatest(it, bounds));
                search.limits = std::array::from_fn(limit);
            }
        }
        Ok(())
    }

    /// The share of losses was chosen because all survived it: other seeds say how probable that is.
    fn repeat(&self, laws: &mut [LawMargins]) -> Result<(), Failure> {
        let wanted = each(laws, |_, search| {
            let share = search.limits[SURVIVES].filter(|_| search.kind == Kind::Loss);
            share.into_iter().filter(|share| *share > 0).collect()
        });
        if wanted.iter().flatten().all(Vec::is_empty) {
            return Ok(());
        }
        let cells = self.cells(self.phases.ticks.len())?;
        let results = self.fly(&cells, &wanted, |_| (), &AtomicU64::new(0))?;
        for (cell, points) in cells.iter().zip(results) {
            for (i, point) in points {
                let law = &mut laws[cell.law];
                law.flights += 1;
                let [survived, flights] = law.searches[i].repeated.get_or_insert_default();
                *survived += u64::from(point.cause.is_none());
                *flights += 1;
            }
        }
        Ok(())
    }
}

/// The strengths that are wanted of each search of each law.
fn each(
    laws: &[LawMargins],
    wanted: impl Fn(&LawMargins, &Search) -> Vec<u64>,
) -> Vec<Vec<Vec<u64>>> {
    let of = |law: &LawMargins| law.searches.iter().map(|it| wanted(law, it)).collect();
    laws.iter().map(of).collect()
}
