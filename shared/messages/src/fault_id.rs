//! The numbers that stand for kinds of faults, and for reasons to refuse one, in messages. Never reuse a number, because
//! logs contain it.

use crate::layout::wire_enum;

wire_enum! {
    pub enum FaultId {
        Drop = 1,
        DropEach = 2,
        Delay = 3,
        Lag = 4,
        Freeze = 5,
        Noise = 6,
        Bias = 7,
        Nan = 8,
        Late = 9,
        Stop = 10,
        Kill = 11,
        Hog = 12,
        Load = 13,
        Switch = 14,
    }
}

wire_enum! {
    pub enum FaultRefusal {
        /// A flight has as many as it can have.
        NoRoom = 1,
        /// Another one has a say in the same ticks.
        Contradiction = 2,
        /// There is none that could be ended.
        NothingToEnd = 3,
        AfterTheEnd = 4,
        /// It stops a stage for less than a tick.
        UnderATick = 5,
        /// The channel has no fresh command on time.
        NotReady = 6,
    }
}
