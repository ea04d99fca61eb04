//! Who worked when: a row for each of several workers, along one axis of time with gaps.

use maud::{Markup, html};

use crate::plot::{BELOW, CHARACTER, HALF_CAPITAL, WIDTH, tenths};

/// Work in a row.
#[derive(Clone, Debug)]
pub struct Work {
    /// When it could have begun, where that is known.
    pub due: Option<f64>,
    /// When it began.
    pub from: f64,
    /// When it ended.
    pub to: f64,
    /// Whether it was done without what it should have worked on.
    pub is_stale: bool,
    /// What it was, for who points at it.
    pub word: String,
}

/// What one worker did.
#[derive(Clone, Debug)]
pub struct Row {
    /// Its name.
    pub label: String,
    /// Its colour.
    pub class: &'static str,
    /// Whether its name stands out.
    pub stands_out: bool,
    /// From when on, and until when it was late.
    pub late: Option<(f64, f64)>,
    /// Its work, in order.
    pub work: Vec<Work>,
}

/// A line over all rows, at the beginning of a stretch of time.
#[derive(Clone, Debug)]
pub struct Begin {
    /// Where.
    pub at: f64,
    /// Its name.
    pub label: String,
}

/// The picture.
#[derive(Clone, Debug)]
pub struct Gantt {
    /// What it shows, for who cannot see it.
    pub title: String,
    /// What the axis shows.
    pub label: String,
    /// What is shown of the time, in order: from, to.
    pub windows: Vec<(f64, f64)>,
    /// Begins of stretches.
    pub begins: Vec<Begin>,
    /// Stretches in which something was missed, with words.
    pub missed: Vec<(f64, f64, String)>,
    /// From the first to the last.
    pub rows: Vec<Row>,
}

/// Height of a row [pixels].
const ROW: f64 = 22.0;
/// Height of a bar [pixels].
const THICK: f64 = 12.0;
/// The least that is seen of a bar [pixels].
const THIN: f64 = 2.0;
/// Height of the row of crosses [pixels].
const CROSSES: f64 = 14.0;
/// Half the size of a cross [pixels].
const HALF: f64 = 3.5;
/// Space above the first row [pixels].
const ABOVE: f64 = 4.0;
/// Space between two windows [pixels].
const GAP: f64 = 36.0;
/// Space to the right of the rows, for half a number [pixels].
const RIGHT: f64 = 14.0;

impl Gantt {
    /// The picture as an `svg` element.
    #[must_use]
    pub fn svg(&self) -> Markup {
        let (left, right) = (self.left(), WIDTH - RIGHT);
        let foot = ABOVE + ROW * self.rows.len() as f64 + CROSSES;
        html! {
            svg viewBox=(format!("0 0 {WIDTH} {}", foot + BELOW)) role="img" aria-label=(self.title) {
                @for (from, to, word) in &self.missed {
                    @let (x, end) = (self.at(*from), self.at(*to));
                    rect.missed-tick.late x=(x) y=(ABOVE) width=(tenths(end - x)) height=(foot - ABOVE) {
                        title { (word) }
                    }
                }
                g.grid {
                    @for begin in &self.begins {
                        @let x = self.at(begin.at);
                        line x1=(x) x2=(x) y1=(ABOVE) y2=(foot) {}
                    }
                    @for (x, label) in self.labels() { text.below x=(x) y=(foot + 15.0) { (label) } }
                    text.of-x x=(right) y=(foot + BELOW - 5.0) { (self.label) }
                }
                @for (i, row) in self.rows.iter().enumerate() { (self.row(row, ABOVE + ROW * (i as f64 + 0.5))) }
                @if !self.missed.is_empty() {
                    text.left x=(left - 5.0) y=(foot - CROSSES / 2.0 + HALF_CAPITAL) { "missed" }
                }
                @for (_, to, _) in &self.missed { path.cross.late d=(cross(self.at(*to), foot - CROSSES / 2.0)) {} }
                path.frame d=(format!("M{left} {ABOVE}V{foot}H{right}")) {}
                @for pair in self.windows.windows(2) {
                    @let middle = (self.at(pair[0].1) + self.at(pair[1].0)) / 2.0;
                    path.frame.gap d=(format!("M{} {}l4 -8m4 0l-4 8", tenths(middle - 4.0), foot + 4.0)) {}
                }
            }
        }
    }

    fn row(&self, row: &Row, y: f64) -> Markup {
        html! {
            text.left.strong[row.stands_out] x=(self.left() - 5.0) y=(y + HALF_CAPITAL) { (row.label) }
            @if let Some((from, to)) = row.late {
                path.late-stage.late d=(format!("M{} {y}H{}", self.at(from), self.at(to))) {}
            }
            g.(row.class) {
                @for work in &row.work {
                    @let (from, to) = (self.at(work.from), self.at(work.to));
                    @if let Some(due) = work.due {
                        path.waited d=(format!("M{} {y}H{from}", self.at(due))) {}
                    }
                    rect.work.stale[work.is_stale] x=(from) y=(y - THICK / 2.0)
                        width=(tenths(to - from).max(THIN)) height=(THICK) { title { (work.word) } }
                }
            }
        }
    }

    /// Places of the names of begins: those that have the room.
    fn labels(&self) -> Vec<(f64, &str)> {
        let mut shown = Vec::new();
        let mut free_from = 0.0;
        for begin in &self.begins {
            let (x, half) = (self.at(begin.at), CHARACTER * begin.label.chars().count() as f64 / 2.0);
            if x - half >= free_from && x + half <= WIDTH {
                shown.push((x, begin.label.as_str()));
                free_from = x + half;
            }
        }
        shown
    }

    fn left(&self) -> f64 {
        let names = self.rows.iter().map(|row| row.label.chars().count()).chain([6]);
        10.0 + CHARACTER * names.max().unwrap_or(1) as f64
    }

    /// Place of an instant [pixels]: all that lies between two windows stands in the middle between them.
    fn at(&self, instant: f64) -> f64 {
        let gaps = self.windows.len().saturating_sub(1) as f64;
        let shown: f64 = self.windows.iter().map(|(from, to)| to - from).sum();
        let scale = (WIDTH - RIGHT - self.left() - GAP * gaps) / shown;
        let mut x = self.left();
        for (i, (from, to)) in self.windows.iter().enumerate() {
            if instant < *from {
                return tenths(if i == 0 { x } else { x - GAP / 2.0 });
            }
            x += (instant.min(*to) - from) * scale;
            if instant <= *to || i + 1 == self.windows.len() {
                return tenths(x);
            }
            x += GAP;
        }
        tenths(x)
    }
}

fn cross(x: f64, y: f64) -> String {
    let [left, right, top, foot] = [x - HALF, x + HALF, y - HALF, y + HALF].map(tenths);
    format!("M{left} {top}L{right} {foot}M{left} {foot}L{right} {top}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_begins_are_left_out_where_they_have_no_room() {
        let begin = |i: i32| Begin { at: f64::from(i), label: format!("+{}", 98_000 + i) };
        let gantt = Gantt {
            title: String::new(),
            label: String::new(),
            windows: vec![(0.0, 10.0)],
            begins: (0..=10).map(begin).collect(),
            missed: Vec::new(),
            rows: Vec::new(),
        };
        let shown: Vec<&str> = gantt.labels().into_iter().map(|(_, label)| label).collect();
        assert_eq!(shown, ["+98000", "+98002", "+98004", "+98006", "+98008"]);
    }

    #[test]
    fn instants_between_two_windows_stand_between_them() {
        let gantt = Gantt {
            title: String::new(),
            label: String::new(),
            windows: vec![(-1.0, 3.0), (96.0, 100.0)],
            begins: Vec::new(),
            missed: Vec::new(),
            rows: Vec::new(),
        };
        let places = [-9.0, -1.0, 0.0, 3.0, 50.0, 96.0, 100.0, 9e9].map(|instant| gantt.at(instant));
        assert!(places.windows(2).all(|pair| pair[0] <= pair[1]), "{places:?}");
        assert_eq!((places[0], places[7]), (places[1], places[6]), "what lies beyond stands at the ends");
        assert!((places[5] - places[3] - GAP).abs() < 0.11 && (places[4] - places[3] - GAP / 2.0).abs() < 0.11);
        assert!((places[6] - (WIDTH - RIGHT)).abs() < 0.11, "{places:?}");
    }
}
