//! Frames of MAVLink over UDP or TCP, of one ground station.
//!
//! Over UDP, the socket is connected: the kernel drops what does not come from the address that the vehicle reports to.
//! Over TCP, a second ground station is refused while the first one is connected.

use std::io::{self, ErrorKind, Read, Write as _};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};

use mavlink::MavlinkReader;
use mavlink::dialects::common::MavMessage;
use mavlink::error::MessageReadError;
use mavlink::{MAVLinkMessageRaw, MAVLinkV2MessageRaw, MavHeader, Message as _, consts};

use rustix::net::sockopt::set_socket_send_buffer_size;

use super::protocol::{COMPONENT, SYSTEM};

/// Datagrams, or pieces of a stream, that are read in a row.
const IN_A_ROW: usize = 64;
const PIECE_BYTES: usize = 2048;
const SEND_BUFFER_BYTES: usize = 64 << 10;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Address {
    /// Reports to this address.
    Udp(SocketAddr),
    /// Waits for a ground station at this address.
    Tcp(SocketAddr),
}

impl Address {
    pub fn is_of_this_machine(&self) -> bool {
        let (Self::Udp(address) | Self::Tcp(address)) = self;
        address.ip().is_loopback()
    }
}

/// A frame whose checksum is right.
#[derive(Debug)]
pub enum Frame {
    Message(MavHeader, Box<MavMessage>),
    /// With a signature, which is not checked.
    Signed,
}

pub struct Link {
    transport: Transport,
    sequence: u8,
}

enum Transport {
    Udp(UdpSocket),
    Tcp {
        listener: TcpListener,
        station: Option<MavlinkReader<Budget>>,
    },
}

/// A stream of which only so much is read in a row: who sends without end does not keep the vehicle from sending.
struct Budget {
    stream: TcpStream,
    pieces: usize,
}

impl Read for Budget {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.pieces = self.pieces.checked_sub(1).ok_or(ErrorKind::WouldBlock)?;
        let most = into.len().min(PIECE_BYTES);
        self.stream.read(&mut into[..most])
    }
}

impl Link {
    pub fn open(address: Address) -> io::Result<Self> {
        let transport = match address {
            Address::Udp(to) => {
                let any: SocketAddr = match to.is_ipv4() {
                    true => (Ipv4Addr::UNSPECIFIED, 0).into(),
                    false => (Ipv6Addr::UNSPECIFIED, 0).into(),
                };
                let socket = UdpSocket::bind(any)?;
                socket.connect(to)?;
                socket.set_nonblocking(true)?;
                Transport::Udp(socket)
            }
            Address::Tcp(at) => {
                let listener = TcpListener::bind(at)?;
                listener.set_nonblocking(true)?;
                Transport::Tcp {
                    listener,
                    station: None,
                }
            }
        };
        Ok(Self {
            transport,
            sequence: 0,
        })
    }

    /// The address at which a ground station can connect, or to which the vehicle reports.
    pub fn address(&self) -> io::Result<SocketAddr> {
        match &self.transport {
            Transport::Udp(socket) => socket.peer_addr(),
            Transport::Tcp { listener, .. } => listener.local_addr(),
        }
    }

    /// Passes on what has arrived.
    pub fn receive(&mut self, mut each: impl FnMut(Frame)) {
        match &mut self.transport {
            Transport::Udp(socket) => {
                let mut datagram = [0; PIECE_BYTES];
                for _ in 0..IN_A_ROW {
                    match socket.recv(&mut datagram) {
                        Ok(length) => frames(&datagram[..length], &mut each),
                        Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                        // As long as no ground station listens.
                        Err(_) => {}
                    }
                }
            }
            Transport::Tcp { listener, station } => {
                if let Some(reader) = station {
                    reader.get_mut().pieces = IN_A_ROW;
                    if read_all(reader, &mut each) != ErrorKind::WouldBlock {
                        *station = None;
                    }
                }
                while let Ok((stream, _)) = listener.accept() {
                    if station.is_none() && prepare(&stream).is_ok() {
                        *station = Some(MavlinkReader::new(Budget { stream, pieces: 0 }));
                    }
                }
            }
        }
    }

    /// Sends a message to the ground station, if there is one. One that is too slow is disconnected.
    pub fn send(&mut self, message: &MavMessage) {
        let header = MavHeader {
            system_id: SYSTEM.into(),
            component_id: COMPONENT,
            sequence: self.sequence,
        };
        let mut frame = MAVLinkV2MessageRaw::new();
        frame.serialize_message(header, message);
        match &mut self.transport {
            Transport::Udp(socket) => {
                // Refused as long as no ground station listens.
                let _ = socket.send(frame.raw_bytes());
            }
            Transport::Tcp { station, .. } => {
                if let Some(reader) = station
                    && reader
                        .get_mut()
                        .stream
                        .write_all(frame.raw_bytes())
                        .is_err()
                {
                    *station = None;
                }
            }
        }
        self.sequence = self.sequence.wrapping_add(1);
    }
}

/// Lets a stream wait for nothing, and notice soon that its other end does not read.
fn prepare(stream: &TcpStream) -> io::Result<()> {
    stream.set_nonblocking(true)?;
    stream.set_nodelay(true)?;
    Ok(set_socket_send_buffer_size(stream, SEND_BUFFER_BYTES)?)
}

/// Passes on the frames of a datagram. None reaches into the next one.
pub fn frames(mut datagram: &[u8], each: &mut impl FnMut(Frame)) {
    let mut reader = MavlinkReader::with_capacity(consts::MAX_FRAME_SIZE, &mut datagram);
    read_all(&mut reader, each);
}

/// Passes on the frames that have arrived; returns why there are no more.
fn read_all(reader: &mut MavlinkReader<impl Read>, each: &mut impl FnMut(Frame)) -> ErrorKind {
    loop {
        match reader.read_any_raw_message::<MavMessage>() {
            Ok(raw) => frame(&raw).into_iter().for_each(&mut *each),
            Err(MessageReadError::Io(e)) => return e.kind(),
            Err(MessageReadError::Parse(_)) => {}
        }
    }
}

/// The message of a frame; none if it is not in the dialect, or has a value that is not.
fn frame(raw: &MAVLinkMessageRaw) -> Option<Frame> {
    if let MAVLinkMessageRaw::V2(raw) = raw
        && raw.incompatibility_flags() & consts::v2::IFLAG_SIGNED != 0
    {
        return Some(Frame::Signed);
    }
    let header = MavHeader {
        system_id: raw.system_id(),
        component_id: raw.component_id(),
        sequence: raw.sequence(),
    };
    let message = MavMessage::parse(raw.version(), raw.message_id(), raw.payload()).ok()?;
    Some(Frame::Message(header, Box::new(message)))
}
