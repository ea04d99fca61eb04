//! The packets of a firmware over UDP.

use std::io::{self, Write};
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::os::fd::{AsFd as _, BorrowedFd};

use crate::{Link, Message, Sample};

/// Longest packet [bytes].
const PACKET_BYTES: usize = 1024;

/// Writes the packet of a sample. Allocates nothing.
pub type WritePacket = fn(&Sample, &mut dyn Write) -> io::Result<()>;

pub fn local(udp: u16) -> SocketAddrV4 {
    SocketAddrV4::new(Ipv4Addr::LOCALHOST, udp)
}

/// A firmware on this machine that sends its motor commands to a port of the rig.
pub struct Udp {
    /// The kernel drops what comes from elsewhere than the first motor commands.
    inbox: UdpSocket,
    has_sender: bool,
    read: fn(&[u8]) -> Message,
    /// Packets of a sample with their sockets; without one, a packet goes to where the motor commands come from.
    packets: Vec<(Option<UdpSocket>, WritePacket)>,
}

impl Udp {
    /// Opens the port of the motor commands. Each packet goes to the firmware's port that is so far above that port; 0 stands
    /// for the port from which the motor commands come.
    pub fn open(
        udp: u16,
        read: fn(&[u8]) -> Message,
        packets: &[(u16, WritePacket)],
    ) -> io::Result<Self> {
        let bind = |udp| {
            let socket = UdpSocket::bind(local(udp))?;
            socket.set_nonblocking(true)?;
            Ok::<_, io::Error>(socket)
        };
        let to = |above: u16| {
            // Another firmware would take the packets.
            drop(UdpSocket::bind((Ipv4Addr::UNSPECIFIED, udp + above))?);
            let socket = bind(0)?;
            socket.connect(local(udp + above))?;
            Ok::<_, io::Error>(socket)
        };
        let inbox = bind(udp)?;
        let open = |&(above, write): &(u16, WritePacket)| {
            let socket = (above > 0).then(|| to(above)).transpose()?;
            Ok((socket, write))
        };
        Ok(Self {
            inbox,
            has_sender: false,
            read,
            packets: packets.iter().map(open).collect::<io::Result<_>>()?,
        })
    }
}

impl Link for Udp {
    fn send(&mut self, sample: &Sample) -> io::Result<()> {
        for (socket, write) in &self.packets {
            let mut packet = [0; PACKET_BYTES];
            let mut left = &mut packet[..];
            write(sample, &mut left)?;
            let bytes = PACKET_BYTES - left.len();
            let socket = socket.as_ref().unwrap_or(&self.inbox);
            // Refused as long as the firmware does not listen there; the other packets go out all the same.
            let _ = socket.send(&packet[..bytes]);
        }
        Ok(())
    }

    fn receive(&mut self) -> io::Result<Message> {
        let mut packet = [0; PACKET_BYTES];
        let (bytes, sender) = self.inbox.recv_from(&mut packet)?;
        let message = (self.read)(&packet[..bytes]);
        if !self.has_sender && matches!(message, Message::Motors(_)) {
            self.inbox.connect(sender)?;
            self.has_sender = true;
        }
        Ok(message)
    }

    fn descriptor(&self) -> BorrowedFd<'_> {
        self.inbox.as_fd()
    }

    fn try_clone(&self) -> io::Result<Box<dyn Link>> {
        let clone = |(socket, write): &(Option<UdpSocket>, WritePacket)| {
            Ok((
                socket.as_ref().map(UdpSocket::try_clone).transpose()?,
                *write,
            ))
        };
        let packets = self.packets.iter().map(clone);
        Ok(Box::new(Self {
            inbox: self.inbox.try_clone()?,
            packets: packets.collect::<io::Result<_>>()?,
            ..*self
        }))
    }
}
