//! Values of parameters as text.

/// An end of a range. That of an airframe of another size is a quotient with many digits, and is shortened.
pub fn bound(value: f64) -> String {
    let text = number(value);
    if text.len() > 8 {
        format!("{value:.2e}")
    } else {
        text
    }
}

/// A value as a user types it; small ones as powers of ten. One on a ramp has many digits, and is shortened.
pub fn number(value: f64) -> String {
    let is_small = value != 0.0 && value.abs() < 1e-3;
    let text = match is_small {
        true => format!("{value:e}"),
        false => format!("{value}"),
    };
    match (text.len() > 12, is_small) {
        (false, _) => text,
        (true, true) => format!("{value:.3e}"),
        (true, false) => format!("{value:.6}"),
    }
}
