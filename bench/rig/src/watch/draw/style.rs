//! Colours and signs that are readable on light, dark and colourless terminals.
//!
//! Every colour stands out on black and on white. Words say the same as colours.

use ratatui::style::{Color, Modifier, Style};

/// How things look.
#[derive(Clone, Copy, Debug)]
pub struct Paint {
    colours: bool,
}

impl Paint {
    /// With colours or without.
    #[must_use]
    pub const fn new(colours: bool) -> Self {
        Self { colours }
    }

    fn colour(self, colour: Color) -> Style {
        if self.colours { Style::new().fg(colour) } else { Style::new() }
    }

    /// What is as it should be.
    #[must_use]
    pub fn good(self) -> Style {
        self.colour(Color::Green)
    }

    /// What is not as it should be.
    #[must_use]
    pub fn bad(self) -> Style {
        self.colour(Color::Red).add_modifier(Modifier::BOLD)
    }

    /// What is measured, in pictures.
    #[must_use]
    pub fn actual(self) -> Style {
        self.colour(Color::Blue).add_modifier(Modifier::BOLD)
    }

    /// What it should be, in pictures.
    #[must_use]
    pub fn reference(self) -> Style {
        self.colour(Color::Magenta)
    }

    /// Headings.
    #[must_use]
    pub fn heading(self) -> Style {
        Style::new().add_modifier(Modifier::BOLD)
    }

    /// What matters less.
    #[must_use]
    pub fn faint(self) -> Style {
        Style::new().add_modifier(Modifier::DIM)
    }

    /// What is selected.
    #[must_use]
    pub fn selected(self) -> Style {
        Style::new().add_modifier(Modifier::REVERSED)
    }

    /// Good or bad.
    #[must_use]
    pub fn verdict(self, good: bool) -> Style {
        if good { self.good() } else { self.bad() }
    }
}
