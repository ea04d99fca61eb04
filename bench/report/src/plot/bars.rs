//! Horizontal bars, each with its name and number.

use maud::{Markup, html};

use crate::plot::scale::Scale;
use crate::plot::{BELOW, CHARACTER, HALF_CAPITAL, WIDTH, tenths};

/// A bar.
#[derive(Clone, Debug)]
pub struct Bar {
    /// What it stands for.
    pub label: String,
    /// Colour.
    pub class: &'static str,
    /// Where it begins.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
    /// Its number.
    pub number: String,
}

/// Height of a row [pixels].
const ROW: f64 = 20.0;
/// Height of a bar [pixels].
const THICK: f64 = 12.0;
/// Space above the first row [pixels].
const ABOVE: f64 = 4.0;

/// Bars below each other on one linear axis from 0 on; `label` names the axis, with unit.
#[must_use]
pub fn bars(title: &str, label: &str, bars: &[Bar]) -> Markup {
    let longest = |text: fn(&Bar) -> &String| bars.iter().map(|bar| text(bar).chars().count()).max().unwrap_or(1);
    let left = 10.0 + CHARACTER * longest(|bar| &bar.label) as f64;
    let right = WIDTH - 10.0 - CHARACTER * longest(|bar| &bar.number) as f64;
    let foot = ABOVE + ROW * bars.len() as f64 + 2.0;
    let scale = Scale::time(0.0, bars.iter().map(|bar| bar.to).fold(0.0, f64::max));
    let at = |value: f64| tenths(left + (right - left) * scale.place(value));
    html! {
        svg viewBox=(format!("0 0 {WIDTH} {}", foot + BELOW)) role="img" aria-label=(title) {
            g.grid {
                @for tick in scale.ticks(4) {
                    line x1=(at(tick.value)) x2=(at(tick.value)) y1=(ABOVE) y2=(foot) {}
                    text.below x=(at(tick.value)) y=(foot + 15.0) { (tick.label) }
                }
                text.of-x x=(right) y=(foot + BELOW - 5.0) { (label) }
            }
            @for (i, bar) in bars.iter().enumerate() {
                @let y = ABOVE + ROW * i as f64 + ROW / 2.0;
                text.left x=(left - 5.0) y=(y + HALF_CAPITAL) { (bar.label) }
                rect.bar.(bar.class) x=(at(bar.from)) y=(y - THICK / 2.0)
                    width=(tenths(at(bar.to) - at(bar.from)).max(1.0)) height=(THICK) {}
                text.number x=(at(bar.to) + 5.0) y=(y + HALF_CAPITAL) { (bar.number) }
            }
            path.frame d=(format!("M{left} {ABOVE}V{foot}H{right}")) {}
        }
    }
}
