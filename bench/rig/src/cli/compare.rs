//! Flags of `compare`.

use std::path::PathBuf;

use clap::Args;

use crate::cli::{CourseArgs, DiffFormat, values};

/// Flags of `compare`.
#[derive(Clone, Debug, Args)]
pub struct CompareArgs {
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub course: CourseArgs,
    /// A law of the outer loop; may be repeated [default: pd]. Every outer law is flown with every inner law and mixer.
    #[arg(long, value_name = "LAW|FILE")]
    pub outer: Vec<String>,
    /// A law of the inner loop; may be repeated [default: adaptive].
    #[arg(long, value_name = "LAW|FILE")]
    pub inner: Vec<String>,
    /// A law of the mixer; may be repeated [default: priority].
    #[arg(long, value_name = "LAW|FILE")]
    pub mixer: Vec<String>,
    /// A flight has recovered from a fault when its true position error stays below this [m].
    #[arg(long, value_name = "M", default_value_t = 0.05, allow_hyphen_values = true, value_parser = values::limit)]
    pub recovered_below: f64,
    /// How to print the comparison.
    #[arg(long, value_enum, default_value_t = DiffFormat::Text)]
    pub format: DiffFormat,
    /// Also write the comparison to this file, as a page with plots.
    #[arg(long, value_name = "FILE.html")]
    pub page: Option<PathBuf>,
    /// Fly once for each row of this file, [[row]] with name and faults, and print Markdown tables.
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["faults", "format", "page"])]
    pub table: Option<PathBuf>,
}
