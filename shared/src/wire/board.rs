//! Notice boards: a value that one process writes and anybody reads, without either waiting for the other.
//!
//! An iceoryx2 blackboard with a single entry. Joining and leaving readers cost the writer nothing, so boards
//! are how observers look at a flight.

use iceoryx2::port::reader::{EntryHandle, Reader};
use iceoryx2::port::writer::{EntryHandleMut, Writer};
use iceoryx2::prelude::{ZeroCopySend, ipc};
use iceoryx2::service::builder::blackboard::{BlackboardCreateError, BlackboardOpenError};
use iceoryx2::service::port_factory::blackboard::PortFactory;

use super::{NODES, Wire, layout_specifier, layout_verifier};
use crate::error::Error;
use crate::layout::Layout;

/// The only key of a board.
const KEY: u64 = 0;

/// A value that can be put on a board.
pub trait Notice: ZeroCopySend + Copy + Default + Layout + std::fmt::Debug + 'static {}
impl<T: ZeroCopySend + Copy + Default + Layout + std::fmt::Debug + 'static> Notice for T {}

impl Wire {
    /// Becomes the writer of a board, also of one whose last writer died while others still read it.
    ///
    /// # Errors
    /// [`Error::Wire`], [`Error::Incompatible`].
    pub fn board<T: Notice>(&self, name: &str) -> Result<Board<T>, Error> {
        let service = match self
            .node
            .service_builder(&self.service_name(name)?)
            .blackboard_creator::<u64>()
            .max_readers(NODES)
            .max_nodes(NODES)
            .add::<T>(KEY, T::default())
            .create_with_attributes(&layout_specifier(T::FINGERPRINT)?)
        {
            Ok(service) => service,
            Err(BlackboardCreateError::AlreadyExists) => {
                self.open_board::<T>(name)?.ok_or_else(|| Error::Absent { what: format!("board `{name}` vanished") })?
            }
            Err(error) => return Err(Error::wire(format!("cannot create board `{name}`"), error)),
        };
        let failed = |e: &dyn std::fmt::Debug| Error::wire(format!("cannot become the writer of board `{name}`"), e);
        let writer = service.writer_builder().create().map_err(|e| failed(&e))?;
        let entry = writer.entry::<T>(&KEY).map_err(|e| failed(&e))?;
        Ok(Board { entry, _writer: writer, _service: service })
    }

    /// A reader of a board; `None` while nobody has put it up.
    ///
    /// # Errors
    /// [`Error::Wire`], [`Error::Incompatible`].
    pub fn board_reader<T: Notice>(&self, name: &str) -> Result<Option<BoardReader<T>>, Error> {
        let Some(service) = self.open_board::<T>(name)? else { return Ok(None) };
        let failed = |e: &dyn std::fmt::Debug| Error::wire(format!("cannot read board `{name}`"), e);
        let reader = service.reader_builder().create().map_err(|e| failed(&e))?;
        let entry = reader.entry::<T>(&KEY).map_err(|e| failed(&e))?;
        Ok(Some(BoardReader { entry, _reader: reader, _service: service }))
    }

    fn open_board<T: Notice>(&self, name: &str) -> Result<Option<PortFactory<ipc::Service, u64>>, Error> {
        let opened = self
            .node
            .service_builder(&self.service_name(name)?)
            .blackboard_opener::<u64>()
            .open_with_attributes(&layout_verifier(T::FINGERPRINT)?);
        match opened {
            Ok(service) => Ok(Some(service)),
            // Being put up or taken down at this moment is as good as not there.
            Err(
                BlackboardOpenError::DoesNotExist
                | BlackboardOpenError::IsMarkedForDestruction
                | BlackboardOpenError::HangsInCreation,
            ) => Ok(None),
            Err(BlackboardOpenError::IncompatibleAttributes) => Err(Error::Incompatible {
                what: format!("board `{name}`"),
                reason: format!("{:?}", BlackboardOpenError::IncompatibleAttributes),
            }),
            Err(error) => Err(Error::wire(format!("cannot open board `{name}`"), error)),
        }
    }
}

/// A board with the right to write on it.
#[allow(missing_debug_implementations, reason = "the middleware's handle has none")]
pub struct Board<T: Notice> {
    entry: EntryHandleMut<ipc::Service, u64, T>,
    _writer: Writer<ipc::Service, u64>,
    _service: PortFactory<ipc::Service, u64>,
}

impl<T: Notice> Board<T> {
    /// Replaces what is on the board.
    pub fn put(&self, value: T) {
        self.entry.update_with_copy(value);
    }
}

/// A board to look at.
#[allow(missing_debug_implementations, reason = "the middleware's handle has none")]
pub struct BoardReader<T: Notice> {
    entry: EntryHandle<ipc::Service, u64, T>,
    _reader: Reader<ipc::Service, u64>,
    _service: PortFactory<ipc::Service, u64>,
}

impl<T: Notice> BoardReader<T> {
    /// What is on the board now; what its last writer left when that is gone.
    #[must_use]
    pub fn get(&self) -> T {
        *self.entry.get()
    }
}
