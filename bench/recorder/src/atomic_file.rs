//! Replaces a file again and again from a separate thread, so that a slow disk does not delay the caller.
//!
//! A reader finds the old text or the new one, never a part. While the disk is busy, one text waits for it; others are left
//! out.

use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::thread;
use std::time::Duration;

use errors::{AsideFile, Failure, InFile as _};

/// How long `close` waits for a slow disk.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(3);

#[derive(Debug)]
pub struct AtomicFileWriter {
    /// None after it was closed.
    texts: Option<SyncSender<String>>,
    failures: Receiver<Failure>,
    is_closed: Arc<AtomicBool>,
}

impl AtomicFileWriter {
    pub fn new(path: PathBuf) -> Result<Self, Failure> {
        let ((texts, handed_over), (failed, failures)) = (sync_channel::<String>(1), channel());
        let is_closed = Arc::new(AtomicBool::new(false));
        let (target, closed) = (path.clone(), Arc::clone(&is_closed));
        let serve = move || {
            for text in handed_over {
                let replaced = replace(&target, &text, &closed).in_file("write", &target);
                let _ = replaced.map_err(|failure| failed.send(failure));
            }
        };
        let thread = thread::Builder::new().name("report".into());
        thread.spawn(serve).in_file("write", &path)?;
        Ok(Self {
            texts: Some(texts),
            failures,
            is_closed,
        })
    }

    /// Hands over the next text, without waiting; returns a failure to write an earlier one.
    pub fn put(&self, text: String) -> Result<(), Failure> {
        if let Some(texts) = &self.texts {
            let _ = texts.try_send(text);
        }
        self.failures.try_recv().map_or(Ok(()), Err)
    }

    /// Stops writing. After that the caller may write the file itself.
    pub fn close(&mut self) {
        self.is_closed.store(true, Ordering::Relaxed);
        self.texts = None;
        // Nothing can fail when the thread has ended.
        while self.failures.recv_timeout(CLOSE_TIMEOUT).is_ok() {}
    }
}

/// Not synced: the log has all that the text says, and a kernel without preemption keeps its processor for as long as it
/// syncs, whatever thread waits for it.
fn replace(target: &Path, text: &str, is_closed: &AtomicBool) -> io::Result<()> {
    let mut aside = AsideFile::create(target)?;
    aside.write_all(text.as_bytes())?;
    // The caller may have closed the writer while the disk blocked: its file must stay.
    if !is_closed.load(Ordering::Relaxed) {
        aside.keep()?;
    }
    Ok(())
}

impl Drop for AtomicFileWriter {
    fn drop(&mut self) {
        self.close();
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_text_is_there_whole_and_nothing_after_the_writer_is_closed() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("report.json");
        let mut file = AtomicFileWriter::new(path.clone()).unwrap();
        let texts = ["one".repeat(10_000), "two".repeat(20_000)];
        for text in &texts {
            file.put(text.clone()).unwrap();
            while fs::read_to_string(&path).ok().as_ref() != Some(text) {
                let there = fs::read_to_string(&path).unwrap_or_default();
                assert!(there.is_empty() || texts.contains(&there));
                thread::yield_now();
            }
        }
        file.close();
        fs::write(&path, "final").unwrap();
        file.put("too late".into()).unwrap();
        drop(file);
        assert_eq!(fs::read_to_string(&path).unwrap(), "final");
        let files = fs::read_dir(place.path()).unwrap().count();
        assert_eq!(files, 1, "nothing else is left");
    }

    #[test]
    fn a_text_of_a_writer_that_is_closed_leaves_the_file_of_the_caller() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("report.json");
        for (is_closed, expected) in [(true, "final"), (false, "late")] {
            fs::write(&path, "final").unwrap();
            replace(&path, "late", &AtomicBool::new(is_closed)).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), expected);
        }
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
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
