//! Keyboard input: changes the dashboard's state, or requests an action.

use std::time::Duration;

use messages::parameters::{Airframe, SPECS};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use crate::fault::{Change, Desired};
use crate::inject::words_of;
use crate::watch::dashboard_model::{Model, Said, Tab};
use report::series::Series;

const TYPED_MAX: usize = 24;
const FAULT_MAX: usize = 120;
/// Allowed characters besides digits: for numbers, `nominal`, shares, and the units of a ramp's duration.
const TYPED: &str = ".+-eE%~nominalmsuhd";

/// The action that a key requests.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    None,
    Quit,
    EndFlight,
    Reset,
    /// Change a parameter, at once or gradually; or inject a fault, permanently or for a time.
    Inject(Vec<Change>, Option<Duration>),
}

impl Model {
    pub fn key(&mut self, key: KeyEvent) -> Action {
        if key.kind == KeyEventKind::Release {
            return Action::None;
        }
        if key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL) {
            return if self.launched {
                Action::EndFlight
            } else {
                Action::Quit
            };
        }
        if self.help {
            self.help = false;
            return if key.code == KeyCode::Char('q') {
                Action::Quit
            } else {
                Action::None
            };
        }
        if self.desk.typed.is_some() {
            // Ctrl-U empties the line; other control keys are ignored.
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
        let present = Tab::ALL
            .iter()
            .position(|tab| *tab == self.tab)
            .unwrap_or(0);
        self.tab = Tab::ALL[(present + by) % Tab::ALL.len()];
    }

    /// Keys on pages with a table.
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
            self.desk.said = Some(Said {
                text: "nobody flies: nothing to inject into".into(),
                refused: true,
            });
        } else if !self.desk.waits {
            (self.desk.typed, self.desk.fault) = (Some(String::new()), fault);
            self.desk.said = None;
        }
    }

    /// Keys while the user types a value.
    fn type_value(&mut self, code: KeyCode) -> Action {
        let fault = self.desk.fault;
        let Some(typed) = &mut self.desk.typed else {
            return Action::None;
        };
        match code {
            KeyCode::Char(c)
                if !fault
                    && typed.len() < TYPED_MAX
                    && (c.is_ascii_digit() || TYPED.contains(c)) =>
            {
                typed.push(c)
            }
            KeyCode::Char(c)
                if fault && typed.len() < FAULT_MAX && (c.is_ascii_graphic() || c == ' ') =>
            {
                typed.push(c)
            }
            KeyCode::Backspace => drop(typed.pop()),
            KeyCode::Esc => self.desk.typed = None,
            KeyCode::Enter if fault => return self.inject_fault(),
            KeyCode::Enter => return self.inject(),
            _ => {}
        }
        Action::None
    }

    /// Injects the typed value; an invalid one stays for correction.
    fn inject(&mut self) -> Action {
        let typed = self.desk.typed.take().unwrap_or_default();
        if typed.is_empty() {
            return Action::None;
        }
        let airframe = self
            .flight
            .as_ref()
            .map_or(Airframe::nominal(), |flight| flight.airframe);
        let wanted = format!("{}={typed}", self.desk.parameter()).parse::<Desired>();
        match wanted.and_then(|wanted| wanted.of(&airframe).map(|_| wanted)) {
            Ok(wanted) => {
                self.desk.waits = true;
                Action::Inject(vec![Change::Parameter(wanted)], None)
            }
            Err(error) => {
                self.desk.typed = Some(typed);
                self.desk.said = Some(Said {
                    text: error.to_string(),
                    refused: true,
                });
                Action::None
            }
        }
    }

    /// Injects the typed fault, such as `state.drop=0.1 for 1s`; an invalid one stays for correction.
    fn inject_fault(&mut self) -> Action {
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
                self.desk.said = Some(Said {
                    text,
                    refused: true,
                });
                Action::None
            }
        }
    }
}
