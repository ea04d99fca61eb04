//! Excitation: how much of each unknown a flight reveals, in e-folds of its error.
//!
//! Why it is needed: claim (18) of "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle"
//! (Imran, Montazeri), that the estimates converge, holds only under persistent excitation. On the exact model a step
//! multiplies the scaled error Gamma^-1/2 ~th by I - G ([`Step::contraction`]), so this module follows two things:
//!
//! ```text
//!     S <- S + G        over each window of 10 s: a Gramian of X, scaled by Gamma, without unit
//!     P <- (I - G) P    what is left of an error since the start, exactly
//! ```
//!
//! The smallest eigenvalue of S is the number of e-folds by which the error in the worst direction falls in a window,
//! as long as single steps are short. P needs no such proviso: it bounds the error of each estimate.
//!
//! [`Step::contraction`]: crate::lyapunov::Step::contraction

use nalgebra::{Cholesky, Matrix3, Vector3};

/// Length of a window of the Gramian [s].
pub const WINDOW_S: f64 = 10.0;

/// E-folds in a window from which on a flight counts as exciting: the error falls by a tenth in 10 s.
pub const EXCITING: f64 = 0.1;

/// Added to the Gramian where it is inverted, so that columns without any signal do not spoil the others.
const RIDGE: f64 = 1e-9;

/// What the flight has shown of the three parameters.
#[derive(Clone, Debug)]
pub struct Excitation {
    window_steps: u64,
    steps: u64,
    gramian: Matrix3<f64>,
    left: Matrix3<f64>,
    /// Of the newest complete window; none before the first is.
    complete: Option<Shown>,
}

/// The newest complete window, or the first one as far as it has come.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shown {
    /// Smallest eigenvalue of the Gramian, e-folds in the window.
    pub smallest: f64,
    /// The least of all windows so far.
    pub least: f64,
    /// Per parameter, 1/(S^-1)_ii: what its column shows that the other two do not, e-folds in the window.
    pub identifiability: Vector3<f64>,
}

impl Excitation {
    /// Before the first step, with ticks of `period_s` [s].
    pub fn new(period_s: f64) -> Self {
        Self {
            window_steps: (WINDOW_S / period_s).round() as u64,
            steps: 0,
            gramian: Matrix3::zeros(),
            left: Matrix3::identity(),
            complete: None,
        }
    }

    /// Takes the contraction G of a step.
    pub fn take(&mut self, contraction: &Matrix3<f64>) {
        self.gramian += contraction;
        self.left -= contraction * self.left;
        self.steps += 1;
        if self.steps == self.window_steps {
            let shown = self.present();
            let least = self
                .complete
                .map_or(shown.least, |before| before.least.min(shown.least));
            self.complete = Some(Shown { least, ..shown });
            self.steps = 0;
            self.gramian = Matrix3::zeros();
        }
    }

    /// The present window, as far as it has come.
    fn present(&self) -> Shown {
        let smallest = self.gramian.symmetric_eigenvalues().min().max(0.0);
        Shown {
            smallest,
            least: smallest,
            identifiability: identifiability(&self.gramian),
        }
    }

    /// Begins anew what is left of the error: a parameter change has made a new one.
    pub fn restart(&mut self) {
        self.left = Matrix3::identity();
    }

    /// The newest complete window, or the first one as far as it has come.
    pub fn shown(&self) -> Shown {
        self.complete.unwrap_or_else(|| self.present())
    }

    /// Per parameter, what is left at the most of a scaled error |Gamma^-1/2 ~th| of 1.
    pub fn left(&self) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.left.row(i).norm())
    }
}

fn identifiability(gramian: &Matrix3<f64>) -> Vector3<f64> {
    // Positive definite unless a sample was not finite.
    Cholesky::new(gramian + RIDGE * Matrix3::identity()).map_or(Vector3::zeros(), |ridged| {
        ridged
            .inverse()
            .diagonal()
            .map(|inverse| (1.0 / inverse - RIDGE).max(0.0))
    })
}
