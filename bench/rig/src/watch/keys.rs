//! What a key does.

use std::time::Duration;

use model::parameters::{Airframe, SPECS};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use crate::fault::{Change, Wanted};
use crate::inject::words_of;
use crate::watch::model::{Model, Said, Tab};
use report::tally::series::Series;

/// Longest value that can be typed.
const TYPED_MAX: usize = 24;
/// The longest words of faults.
const FAULT_MAX: usize = 120;
/// What it may hold besides digits: numbers, `nominal`, shares, and the units of a ramp's time.
const TYPED: &str = ".+-eE%~nominalmsuhd";

/// What a key asks of the outside.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Nothing.
    None,
    /// Leave; the flight goes on.
    Quit,
    /// End the flight.
    EndFlight,
    /// Begin all statistics anew.
    Reset,
    /// Swap a parameter, at once or over a time; or have something fail, for good or for a time.
    Inject(Vec<Change>, Option<Duration>),
}

impl Model {
    /// Takes a key.
    pub fn key(&mut self, key: KeyEvent) -> Action {
        if key.kind == KeyEventKind::Release {
            return Action::None;
        }
        if key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL) {
            return if self.launched { Action::EndFlight } else { Action::Quit };
        }
        if self.help {
            self.help = false;
            return if key.code == KeyCode::Char('q') { Action::Quit } else { Action::None };
        }
        if self.desk.typed.is_some() {
            // A terminal's Ctrl-U empties the line; no other control is a letter of it.
            if key.modifiers.contains(KeyModifiers::CONTROL) {
                if key.code == KeyCode::Char('u') {
                    self.desk.typed = Some(String::new());
                }
                return Action::None;
            }
            return self.type_value(key.code);
        }
        match key.code {
            KeyCode::Char('q') | KeyCode::Esc => return Action::Quit,
            KeyCode::Char('?' | 'h') => self.help = true,
            KeyCode::Char('r') => return Action::Reset,
            KeyCode::Tab | KeyCode::Right => self.turn(1),
            KeyCode::BackTab | KeyCode::Left => self.turn(Tab::ALL.len() - 1),
            KeyCode::Char(digit @ '1'..='6') => {
                self.tab = Tab::ALL[digit as usize - '1' as usize];
            }
            code => self.table(code),
        }
        Action::None
    }

    fn turn(&mut self, by: usize) {
        let present = Tab::ALL.iter().position(|tab| *tab == self.tab).unwrap_or(0);
        self.tab = Tab::ALL[(present + by) % Tab::ALL.len()];
    }

    /// Keys of pages with a table.
    fn table(&mut self, code: KeyCode) {
        let (selected, rows) = match self.tab {
            Tab::Latency => (&mut self.series, Series::all().len()),
            Tab::Plant => (&mut self.desk.selected, SPECS.len()),
            _ => return,
        };
        let last = rows - 1;
        match code {
            KeyCode::Up | KeyCode::Char('k') => *selected = selected.saturating_sub(1),
            KeyCode::Down | KeyCode::Char('j') => *selected = (*selected + 1).min(last),
            KeyCode::Home => *selected = 0,
            KeyCode::End => *selected = last,
            KeyCode::Enter if self.tab == Tab::Plant => self.begin_typing(false),
            KeyCode::Char('f') if self.tab == Tab::Plant => self.begin_typing(true),
            _ => {}
        }
    }

    fn begin_typing(&mut self, fault: bool) {
        if !self.flies() {
            self.desk.said = Some(Said { text: "nobody flies: nothing to inject into".into(), refused: true });
        } else if !self.desk.waits {
            (self.desk.typed, self.desk.fault) = (Some(String::new()), fault);
            self.desk.said = None;
        }
    }

    /// Keys while a value is typed.
    fn type_value(&mut self, code: KeyCode) -> Action {
        let fault = self.desk.fault;
        let Some(typed) = &mut self.desk.typed else { return Action::None };
        match code {
            KeyCode::Char(c) if !fault && typed.len() < TYPED_MAX && (c.is_ascii_digit() || TYPED.contains(c)) => {
                typed.push(c)
            }
            KeyCode::Char(c) if fault && typed.len() < FAULT_MAX && (c.is_ascii_graphic() || c == ' ') => typed.push(c),
            KeyCode::Backspace => drop(typed.pop()),
            KeyCode::Esc => self.desk.typed = None,
            KeyCode::Enter if fault => return self.strike(),
            KeyCode::Enter => return self.inject(),
            _ => {}
        }
        Action::None
    }

    /// What was typed, where it may be injected; what may not stays to be corrected.
    fn inject(&mut self) -> Action {
        let typed = self.desk.typed.take().unwrap_or_default();
        if typed.is_empty() {
            return Action::None;
        }
        let airframe = self.flight.as_ref().map_or(Airframe::nominal(), |flight| flight.airframe);
        let wanted = format!("{}={typed}", self.desk.parameter()).parse::<Wanted>();
        match wanted.and_then(|wanted| wanted.of(&airframe).map(|_| wanted)) {
            Ok(wanted) => {
                self.desk.waits = true;
                Action::Inject(vec![Change::Parameter(wanted)], None)
            }
            Err(error) => {
                self.desk.typed = Some(typed);
                self.desk.said = Some(Said { text: error.to_string(), refused: true });
                Action::None
            }
        }
    }

    /// The fault that was typed, as `state.drop=0.1 for 1s`; what cannot be read stays to be corrected.
    fn strike(&mut self) -> Action {
        let typed = self.desk.typed.take().unwrap_or_default();
        if typed.trim().is_empty() {
            return Action::None;
        }
        match words_of(&typed) {
            Ok((changes, lasts)) => {
                self.desk.waits = true;
                Action::Inject(changes, lasts)
            }
            Err(text) => {
                self.desk.typed = Some(typed);
                self.desk.said = Some(Said { text, refused: true });
                Action::None
            }
        }
    }
}
