//! Replaces a file again and again from a separate thread, so that a slow disk does not delay the caller.
//!
//! A reader finds the old text or the new one, never a part. If several texts arrive while the disk is busy, only the
//! newest is written.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use errors::{Failure, InFile as _};

/// How long `close` waits for a slow disk.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(3);

#[derive(Debug)]
pub struct AtomicFileWriter(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<WriterState>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct WriterState {
    next: Option<String>,
    busy: bool,
    is_closed: bool,
    /// The first write error, until `put` returns it.
    error: Option<Failure>,
}

impl AtomicFileWriter {
    pub fn new(path: PathBuf) -> Result<Self, Failure> {
        let shared = Arc::new(Shared::default());
        let (writer, target) = (Arc::clone(&shared), path.clone());
        thread::Builder::new()
            .name("report".into())
            .spawn(move || writer.serve(&target))
            .in_file("write", &path)?;
        Ok(Self(shared))
    }

    /// Hands over the next text, without waiting.
    pub fn put(&self, text: String) -> Result<(), Failure> {
        let mut state = self.0.state();
        state.next = Some(text);
        self.0.changed.notify_all();
        state.error.take().map_or(Ok(()), Err)
    }

    /// Stops writing. After that the caller may write the file itself.
    pub fn close(&self) {
        let mut state = self.0.state();
        (state.next, state.is_closed) = (None, true);
        self.0.changed.notify_all();
        let is_busy = |state: &mut WriterState| state.busy;
        let changed = &self.0.changed;
        let waited = changed.wait_timeout_while(state, CLOSE_TIMEOUT, is_busy);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}

impl Drop for AtomicFileWriter {
    fn drop(&mut self) {
        self.close();
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, WriterState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn serve(&self, path: &Path) {
        let draft = path.with_extension("json.next");
        while let Some(text) = self.next() {
            let drafted = fs::write(&draft, text).in_file("write", &draft);
            // The caller closed the writer while the disk blocked: its file must stay.
            let is_closed = self.state().is_closed;
            let replaced = if is_closed {
                let _ = fs::remove_file(&draft);
                Ok(())
            } else {
                drafted.and_then(|()| fs::rename(&draft, path).in_file("write", path))
            };
            let mut state = self.state();
            state.busy = false;
            if let Err(failure) = replaced {
                state.error.get_or_insert(failure);
            }
            self.changed.notify_all();
        }
    }

    fn next(&self) -> Option<String> {
        let state = self.state();
        let waited = self
            .changed
            .wait_while(state, |state| state.next.is_none() && !state.is_closed);
        let mut state = waited.unwrap_or_else(PoisonError::into_inner);
        state.busy = state.next.is_some();
        state.next.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn await_text(path: &Path, text: &str) {
        while fs::read_to_string(path).ok().as_deref() != Some(text) {
            thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn the_newest_text_is_there_in_the_end_and_nothing_after_it_is_closed() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("report.json");
        let file = AtomicFileWriter::new(path.clone()).unwrap();
        (0..100).for_each(|i| file.put(format!("text {i}")).unwrap());
        await_text(&path, "text 99");
        file.close();
        fs::write(&path, "final").unwrap();
        file.put("too late".into()).unwrap();
        drop(file);
        assert_eq!(fs::read_to_string(&path).unwrap(), "final");
        let files = fs::read_dir(place.path()).unwrap().count();
        assert_eq!(files, 1, "no draft is left");
    }

    #[test]
    fn a_file_that_cannot_be_written_is_said_with_the_next_text() {
        let file = AtomicFileWriter::new("/nowhere/report.json".into()).unwrap();
        file.put("lost".into()).unwrap();
        let failure = loop {
            if let Err(failure) = file.put("lost".into()) {
                break failure.to_string();
            }
            thread::sleep(Duration::from_millis(1));
        };
        assert!(failure.contains("/nowhere/report.json"), "{failure}");
    }
}
