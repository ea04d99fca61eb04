//! A flight as a picture: path, position error and estimates, with the swaps marked.

use std::path::Path;

use plotters::prelude::*;

use crate::failure::Failure;
use crate::in_process::TickRecord;

/// Size of the picture [pixels].
const SIZE: (u32, u32) = (1200, 760);
/// Points kept of a flight: more than the picture has pixels across.
const POINTS: u64 = 3000;

const ACTUAL: RGBColor = RGBColor(31, 119, 180);
const REFERENCE: RGBColor = RGBColor(255, 127, 14);
const SWAP: RGBColor = RGBColor(190, 40, 40);
const MUTED: RGBColor = RGBColor(110, 110, 110);

/// Collects what the picture shows.
#[derive(Debug)]
pub struct FlightPlot {
    period_s: f64,
    every_ticks: u64,
    points: Vec<Point>,
    /// Begin of each parameter epoch after the first [s].
    swaps_s: Vec<f64>,
    parameter_epoch: u64,
}

#[derive(Clone, Copy, Debug)]
struct Point {
    t_s: f64,
    position: [f64; 3],
    reference: [f64; 3],
    error_m: f64,
    estimate: [f64; 3],
    actual: [f64; 3],
}

impl FlightPlot {
    /// A picture of a flight up to `last_tick`, with ticks of `period_s` [s].
    #[must_use]
    pub fn new(period_s: f64, last_tick: u64) -> Self {
        let every_ticks = (last_tick / POINTS).max(1);
        Self { period_s, every_ticks, points: Vec::new(), swaps_s: Vec::new(), parameter_epoch: 0 }
    }

    /// Takes a tick.
    pub fn take(&mut self, record: &TickRecord) {
        let (state, truth) = (&record.state, &record.state.truth);
        let t_s = record.tick as f64 * self.period_s;
        if state.parameter_epoch != self.parameter_epoch {
            self.parameter_epoch = state.parameter_epoch;
            self.swaps_s.push(t_s);
        }
        let Some(setpoint) = &record.setpoint else { return };
        if record.tick.is_multiple_of(self.every_ticks) {
            self.points.push(Point {
                t_s,
                position: state.position_w_m,
                reference: setpoint.reference_position_w_m,
                error_m: controller::outer::position_error_m(state, setpoint),
                estimate: record.wrench.estimate,
                actual: truth.theta(),
            });
        }
    }

    /// Draws the picture.
    ///
    /// # Errors
    /// [`Failure`] names the file.
    pub fn write(&self, path: &Path, title: &str) -> Result<(), Failure> {
        self.draw(path, title).map_err(|e| Failure::failed(format!("cannot draw {}: {e}", path.display())))
    }

    fn draw(&self, path: &Path, title: &str) -> Result<(), Box<dyn std::error::Error>> {
        let root = SVGBackend::new(path, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let root = root.titled(title, ("sans-serif", 22))?;
        let (left, right) = root.split_horizontally(520);
        // As high as wide inside its labels, so that both axes have one scale.
        let (above, below) = left.split_vertically(522);
        self.draw_path(&above)?;
        self.draw_over_time(&below, "height z [m]", |p| p.position[2], Some(("reference", &|p| p.reference[2])))?;
        let panels = right.split_evenly((4, 1));
        self.draw_over_time(&panels[0], "position error [m]", |p| p.error_m, None)?;
        let estimates =
            ["I_R [1e-5 kg m^2]", "k_r [N m s]", "delta [rad/s^2]"].into_iter().zip([1e5, 1.0, 1.0]).enumerate();
        for (i, (label, scale)) in estimates {
            let actual: Curve<'_> = &move |p| p.actual[i] * scale;
            self.draw_over_time(&panels[i + 1], label, move |p| p.estimate[i] * scale, Some(("true", actual)))?;
        }
        root.present()?;
        Ok(())
    }

    fn draw_path<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, plotters::coord::Shift>,
    ) -> Result<(), Box<dyn std::error::Error>>
    where
        DB::ErrorType: 'static,
    {
        let both = || self.points.iter().flat_map(|p| [p.position, p.reference]);
        let (x_min, x_max) = range(both().map(|p| p[0]));
        let (y_min, y_max) = range(both().map(|p| p[1]));
        // The larger extent around each middle, with a margin.
        let half = (0.55 * (x_max - x_min).max(y_max - y_min)).max(0.05);
        let (x, y) = ((x_min + x_max) / 2.0, (y_min + y_max) / 2.0);
        let mut chart = ChartBuilder::on(area)
            .caption("path seen from above", ("sans-serif", 16))
            .margin(8)
            .margin_right(16)
            .x_label_area_size(34)
            .y_label_area_size(56)
            .build_cartesian_2d(x - half..x + half, y - half..y + half)?;
        chart.configure_mesh().light_line_style(WHITE).x_desc("x [m]").y_desc("y [m]").draw()?;
        let line = |pick: fn(&Point) -> [f64; 3]| self.points.iter().map(move |p| (pick(p)[0], pick(p)[1]));
        chart
            .draw_series(LineSeries::new(line(|p| p.reference), REFERENCE.stroke_width(2)))?
            .label("reference")
            .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], REFERENCE.stroke_width(2)));
        chart
            .draw_series(LineSeries::new(line(|p| p.position), ACTUAL.stroke_width(1)))?
            .label("flown")
            .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], ACTUAL.stroke_width(2)));
        legend(&mut chart, SeriesLabelPosition::UpperMiddle)
    }

    fn draw_over_time<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, plotters::coord::Shift>,
        label: &str,
        value: impl Fn(&Point) -> f64,
        target: Option<(&str, Curve<'_>)>,
    ) -> Result<(), Box<dyn std::error::Error>>
    where
        DB::ErrorType: 'static,
    {
        let end_s = self.points.last().map_or(1.0, |p| p.t_s).max(1e-3);
        let targets = self.points.iter().filter_map(|p| Some(target?.1(p)));
        let (low, high) = range(self.points.iter().map(&value).chain(targets));
        let margin = ((high - low) * 0.08).max(1e-9);
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .margin_right(22)
            .x_label_area_size(34)
            .y_label_area_size(66)
            .build_cartesian_2d(0.0..end_s, low - margin..high + margin)?;
        chart.configure_mesh().light_line_style(WHITE).y_labels(5).x_desc("time [s]").y_desc(label).draw()?;
        for swap_s in &self.swaps_s {
            let mark = [(*swap_s, low - margin), (*swap_s, high + margin)];
            chart.draw_series(LineSeries::new(mark, SWAP.stroke_width(1)))?;
        }
        if let Some((name, target)) = target {
            let line = self.points.iter().map(|p| (p.t_s, target(p)));
            chart
                .draw_series(LineSeries::new(line, REFERENCE.stroke_width(2)))?
                .label(name)
                .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], REFERENCE.stroke_width(2)));
        }
        let line = self.points.iter().map(|p| (p.t_s, value(p)));
        chart.draw_series(LineSeries::new(line, ACTUAL.stroke_width(1)))?;
        if target.is_some() {
            legend(&mut chart, SeriesLabelPosition::LowerRight)?;
        }
        Ok(())
    }
}

/// A number of a point, to be drawn over time.
type Curve<'a> = &'a dyn Fn(&Point) -> f64;

type Chart<'a, DB> =
    ChartContext<'a, DB, Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>>;

fn legend<'a, DB: DrawingBackend + 'a>(
    chart: &mut Chart<'a, DB>,
    position: SeriesLabelPosition,
) -> Result<(), Box<dyn std::error::Error>>
where
    DB::ErrorType: 'static,
{
    chart.configure_series_labels().position(position).background_style(WHITE.mix(0.8)).border_style(MUTED).draw()?;
    Ok(())
}

/// Smallest and largest of some numbers; (0, 1) of none.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values
        .fold(None, |range: Option<(f64, f64)>, v| Some(range.map_or((v, v), |(a, b)| (a.min(v), b.max(v)))))
        .unwrap_or((0.0, 1.0))
}
