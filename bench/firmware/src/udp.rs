//! Messages over UDP.

use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};

use crate::Message;

/// Longest packet [bytes].
pub const PACKET_BYTES: usize = 1024;

pub fn local(udp: u16) -> SocketAddrV4 {
    SocketAddrV4::new(Ipv4Addr::LOCALHOST, udp)
}

/// A port of this machine to which one program sends: where the first motor commands came from. The kernel drops what
/// comes from elsewhere after them.
pub struct Inbox {
    pub socket: UdpSocket,
    has_sender: bool,
}

impl Inbox {
    pub fn open(udp: u16) -> io::Result<Self> {
        let socket = UdpSocket::bind(local(udp))?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            socket,
            has_sender: false,
        })
    }

    pub fn try_clone(&self) -> io::Result<Self> {
        Ok(Self {
            socket: self.socket.try_clone()?,
            ..*self
        })
    }

    pub fn receive(&mut self, read: fn(&[u8]) -> Message) -> io::Result<Message> {
        let mut packet = [0; PACKET_BYTES];
        let (bytes, sender) = self.socket.recv_from(&mut packet)?;
        let message = read(&packet[..bytes]);
        if !self.has_sender && matches!(message, Message::Motors(_)) {
            self.socket.connect(sender)?;
            self.has_sender = true;
        }
        Ok(message)
    }
}
