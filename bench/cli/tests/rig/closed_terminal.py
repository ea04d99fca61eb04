"""Runs a command in a terminal of its own. SIGUSR1 closes the terminal; without it, the command's end does.

Everything on the terminal goes to standard output, then a line `ended CODE icanon BOOL`: how the command ended (a
negative code is a signal's number), and whether the terminal takes lines, as it did at the start.
"""

import fcntl
import os
import pty
import select
import signal
import struct
import sys
import termios

wake_read, wake_write = os.pipe()
signal.signal(signal.SIGUSR1, lambda *_: os.write(wake_write, b"x"))
child, terminal = pty.fork()
if child == 0:
    signal.signal(signal.SIGUSR1, signal.SIG_DFL)
    fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    os.execvp(sys.argv[1], sys.argv[1:])
icanon = None
while True:
    readable, _, _ = select.select([terminal, wake_read], [], [])
    if wake_read in readable:
        break
    try:
        said = os.read(terminal, 65536)
    except OSError:  # The last process on the terminal has ended.
        break
    os.write(1, said)
    icanon = bool(termios.tcgetattr(terminal)[3] & termios.ICANON)
os.close(terminal)
code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
print(f"\nended {code} icanon {icanon}", flush=True)
