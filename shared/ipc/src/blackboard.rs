//! Blackboards: one process writes a value, any process reads it, and none waits.
//!
//! A blackboard is an iceoryx2 blackboard with one value. Readers that join or leave cost the writer nothing, so observers
//! follow a flight through blackboards.
//!
//! A writer that is killed keeps its right to write an entry for as long as any process has the blackboard open
//! (iceoryx2 0.10). A blackboard therefore has several entries, its sheets. A writer takes the first free sheet, and readers
//! look at the sheet that was written last.

use std::cell::Cell;

use iceoryx2::port::reader::{BlackboardValue, EntryHandle, Reader, ReaderCreateError};
use iceoryx2::port::writer::{EntryHandleMut, EntryHandleMutError, Writer, WriterCreateError};
use iceoryx2::prelude::{ZeroCopySend, ipc};
use iceoryx2::service::builder::blackboard::{self, BlackboardCreateError, BlackboardOpenError};
use iceoryx2::service::port_factory::blackboard::PortFactory;

use crate::access::{NODES, Wire, layout_attributes, not_opened, shortage_of};
use crate::error::{Error, Refusal, RefusalKind, Tried as _};
use crate::sys::Payload;
use messages::enum_registry::Fingerprint as _;
use messages::layout::Layout;

/// Sheets of a blackboard: one more than the writers that may be killed while the blackboard has a reader.
pub const SHEETS: u64 = 64;
/// Sheets that a reader looks at beyond the last one that was written on: so many writers in a row may be killed after
/// they took a sheet and before they wrote on it.
const AHEAD: usize = 7;

#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[repr(C)]
struct BoardSlot<T: Notice> {
    /// 1 after the first write.
    written: u64,
    value: Payload<T>,
}

pub trait Notice: Default + Layout + std::fmt::Debug {}
impl<T: Default + Layout + std::fmt::Debug> Notice for T {}

type Open = PortFactory<ipc::Service, u64>;
type Creator = blackboard::Creator<u64, ipc::Service>;

fn writer(service: &Open) -> Result<Writer<ipc::Service, u64>, WriterCreateError> {
    service.writer_builder().create()
}

fn reader(service: &Open) -> Result<Reader<ipc::Service, u64>, ReaderCreateError> {
    service.reader_builder().create()
}

impl Wire {
    /// Becomes the writer of a blackboard, even if its last writer died while others still read it.
    pub fn blackboard<T: Notice>(&self, name: &str) -> Result<Blackboard<T>, Error> {
        let fill = |board: Creator| {
            (0..SHEETS).fold(board, |board, sheet| {
                board.add(sheet, BoardSlot::<T>::default())
            })
        };
        let service = self.create_board(name, T::FINGERPRINT, &fill)?;
        let failed = || format!("cannot become the writer of board `{name}`");
        let writer = writer(&service).wire(failed)?;
        let mut sheets = (0..SHEETS).map(|sheet| writer.entry(&sheet));
        let is_taken =
            |sheet: &Result<_, _>| matches!(sheet, Err(EntryHandleMutError::HandleAlreadyExists));
        let free = sheets
            .find(|sheet| !is_taken(sheet))
            .unwrap_or(Err(EntryHandleMutError::HandleAlreadyExists));
        let sheet = free.wire(failed)?;
        Ok(Blackboard {
            sheet,
            _writer: writer,
            _service: service,
        })
    }

    // The functions that open a board are not generic, so that the middleware's services are compiled in this crate alone.
    fn create_board(
        &self,
        name: &str,
        fingerprint: u64,
        fill: &dyn Fn(Creator) -> Creator,
    ) -> Result<Open, Error> {
        let service_name = self.service_name(name)?;
        let (layout, _) = layout_attributes(fingerprint)?;
        let opener = self.blackboard_opener(name, fingerprint)?;
        self.open_service(format!("board `{name}`"), || {
            let empty = self
                .node
                .service_builder(&service_name)
                .blackboard_creator::<u64>()
                .max_readers(NODES)
                .max_nodes(NODES);
            match fill(empty).create_with_attributes(&layout) {
                Err(BlackboardCreateError::AlreadyExists) => opener().map_err(Refusal::of),
                created => created.map_err(Refusal::of),
            }
        })
    }

    pub fn blackboard_reader<T: Notice>(
        &self,
        name: &str,
    ) -> Result<Option<BlackboardReader<T>>, Error> {
        let Some(service) = self.open_board(name, T::FINGERPRINT)? else {
            return Ok(None);
        };
        let failed = || format!("cannot read board `{name}`");
        let reader = reader(&service).wire(failed)?;
        let sheets = (0..SHEETS)
            .map(|sheet| {
                let sheet = reader.entry::<BoardSlot<T>>(&sheet).wire(failed)?;
                Ok(Look {
                    before: sheet.get(),
                    sheet,
                })
            })
            .collect::<Result<Vec<_>, Error>>()?;
        let last = sheets
            .iter()
            .rposition(|look| look.before.written == 1)
            .unwrap_or(0);
        Ok(Some(BlackboardReader {
            sheets,
            last: Cell::new(last),
            _reader: reader,
            _service: service,
        }))
    }

    fn blackboard_opener(
        &self,
        name: &str,
        fingerprint: u64,
    ) -> Result<impl Fn() -> Result<Open, BlackboardOpenError>, Error> {
        let service_name = self.service_name(name)?;
        let (_, layout) = layout_attributes(fingerprint)?;
        Ok(move || {
            self.node
                .service_builder(&service_name)
                .blackboard_opener::<u64>()
                .open_with_attributes(&layout)
        })
    }

    fn open_board(&self, name: &str, fingerprint: u64) -> Result<Option<Open>, Error> {
        let error = match self.blackboard_opener(name, fingerprint)?() {
            Ok(service) => return Ok(Some(service)),
            Err(BlackboardOpenError::DoesNotExist) => return Ok(None),
            Err(error) => Refusal::of(error),
        };
        // One that is being created or removed is as good as not there, unless only this process cannot open it.
        if error.kind == RefusalKind::Passing && shortage_of(&self.instance).is_none() {
            return Ok(None);
        }
        Err(not_opened(&self.instance, format!("board `{name}`"), error))
    }
}

pub struct Blackboard<T: Notice> {
    sheet: EntryHandleMut<ipc::Service, u64, BoardSlot<T>>,
    _writer: Writer<ipc::Service, u64>,
    _service: Open,
}

impl<T: Notice> Blackboard<T> {
    pub fn put(&self, value: T) {
        self.sheet.update_with_copy(BoardSlot {
            written: 1,
            value: Payload(value),
        });
    }
}

struct Look<T: Notice> {
    sheet: EntryHandle<ipc::Service, u64, BoardSlot<T>>,
    before: BlackboardValue<BoardSlot<T>>,
}

pub struct BlackboardReader<T: Notice> {
    sheets: Vec<Look<T>>,
    /// The last one that was written on, as far as seen.
    last: Cell<usize>,
    _reader: Reader<ipc::Service, u64>,
    _service: Open,
}

impl<T: Notice> BlackboardReader<T> {
    /// The present value. If the writer has gone, its last one.
    pub fn get(&self) -> T {
        let mut last = self.last.get();
        // One look at a counter for each of the next sheets: they are taken in order.
        let written_after = |last: usize| {
            let next = last + 1..self.sheets.len().min(last + 1 + AHEAD);
            let is_written = |sheet: &usize| {
                let look = &self.sheets[*sheet];
                !look.sheet.is_up_to_date(&look.before)
            };
            next.rev().find(is_written)
        };
        while let Some(later) = written_after(last) {
            last = later;
        }
        self.last.set(last);
        self.sheets[last].sheet.get().value.0
    }

    /// The value that was written since the last call, or since the reader was opened: usually none, for the cost of
    /// reading a counter. Only of a writer that had written before the reader was opened.
    pub fn news(&mut self) -> Option<T> {
        let Look { sheet, before } = &mut self.sheets[self.last.get()];
        if sheet.is_up_to_date(before) {
            return None;
        }
        *before = sheet.get();
        Some(before.value.0)
    }
}
