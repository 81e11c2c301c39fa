//! Reading a stream.

use std::time::Duration;

use crate::library::{InletHandle, Lsl};
use crate::{LslError, Stream};

/// Seconds of samples that liblsl keeps while nobody pulls; older ones vanish.
const KEPT_S: i32 = 10;

/// liblsl's numbers of errors.
const TIMEOUT: i32 = -1;
const LOST: i32 = -2;

/// A connection to a stream. It does not reconnect by itself: what comes back may have another rate, so it is to be looked
/// for, described and opened anew.
#[derive(Debug)]
pub struct Inlet {
    lsl: Lsl,
    handle: InletHandle,
    stream: String,
    channels: usize,
}

impl Drop for Inlet {
    fn drop(&mut self) {
        // SAFETY: the handle is this value's own and not used after.
        unsafe { (self.lsl.functions.destroy_inlet)(self.handle) };
    }
}

// SAFETY: liblsl binds its handles to no thread; whoever has this one is the only one to pull.
unsafe impl Send for Inlet {}

impl Inlet {
    /// An inlet for this stream; nothing flows before [`Inlet::open`].
    ///
    /// # Errors
    ///
    /// [`LslError::Refused`] when liblsl cannot make one.
    pub fn new(lsl: Lsl, stream: &Stream) -> Result<Inlet, LslError> {
        let name = stream.facts.name.clone();
        // SAFETY: the description lives through the call; the inlet copies it.
        let handle = unsafe { (lsl.functions.create_inlet)(stream.info(), KEPT_S, 0, 0) };
        if handle.is_null() {
            return Err(LslError::Refused { stream: name, what: "an inlet", code: 0 });
        }
        Ok(Inlet { lsl, handle, stream: name, channels: stream.facts.channels })
    }

    /// The stream with all that it says, its channels among it.
    ///
    /// # Errors
    ///
    /// [`LslError::Timeout`] and [`LslError::Lost`].
    pub fn describe(&self, wait: Duration) -> Result<Stream, LslError> {
        let mut code = 0;
        // SAFETY: the handle is valid, and a code is written.
        let info = unsafe { (self.lsl.functions.get_fullinfo)(self.handle, wait.as_secs_f64(), &mut code) };
        self.check(code, "its description")?;
        if info.is_null() {
            return Err(LslError::Timeout { stream: self.stream.clone(), what: "its description" });
        }
        // SAFETY: the handle is new, and the caller's.
        Ok(unsafe { Stream::own(self.lsl, info) })
    }

    /// Lets samples flow. Describe the stream first: liblsl would otherwise ask for that in the first pull, however long it takes.
    ///
    /// # Errors
    ///
    /// [`LslError::Timeout`] and [`LslError::Lost`].
    pub fn open(&mut self, wait: Duration) -> Result<(), LslError> {
        let mut code = 0;
        // SAFETY: the handle is valid, and a code is written.
        unsafe { (self.lsl.functions.open_stream)(self.handle, wait.as_secs_f64(), &mut code) };
        self.check(code, "its samples")
    }

    /// What is added to the stream's time stamps to have them on our clock, s. The first time, it is measured (0.6 s); liblsl
    /// then renews it every 2 s by itself, and this gives the newest.
    ///
    /// # Errors
    ///
    /// [`LslError::Timeout`] and [`LslError::Lost`].
    pub fn time_correction(&self, wait: Duration) -> Result<f64, LslError> {
        let mut code = 0;
        // SAFETY: the handle is valid, and a code is written.
        let correction_s =
            unsafe { (self.lsl.functions.time_correction)(self.handle, wait.as_secs_f64(), &mut code) };
        self.check(code, "its clock")?;
        Ok(correction_s)
    }

    /// Waits up to `wait` for a sample, and takes it and all that wait behind it, as far as there is room: `[samples × channels]`
    /// into `instants`, a time stamp each into `stamps`. Gives how many samples came. Allocates nothing itself.
    ///
    /// # Errors
    ///
    /// [`LslError::Lost`] when the connection broke, even if samples still wait.
    ///
    /// # Panics
    ///
    /// When there is no room for a sample, or not for all channels of `stamps`.
    pub fn pull(
        &mut self,
        instants: &mut [f32],
        stamps: &mut [f64],
        wait: Duration,
    ) -> Result<usize, LslError> {
        assert!(
            !stamps.is_empty() && instants.len() == stamps.len() * self.channels,
            "room for each channel"
        );
        let functions = self.lsl.functions;
        let mut code = 0;
        // SAFETY: there is room for a sample of all channels, and a code is written.
        let stamp = unsafe {
            let room = instants.as_mut_ptr();
            (functions.pull_sample_f)(self.handle, room, self.channels as i32, wait.as_secs_f64(), &mut code)
        };
        if code == TIMEOUT {
            return Ok(0);
        }
        if stamp == 0.0 {
            return self.check(code, "its samples").map(|()| 0);
        }
        stamps[0] = stamp;
        let (instants, stamps) = (&mut instants[self.channels..], &mut stamps[1..]);
        if stamps.is_empty() {
            return Ok(1);
        }
        // SAFETY: both have room for as many values as is said, and a code is written.
        let values = unsafe {
            (functions.pull_chunk_f)(
                self.handle,
                instants.as_mut_ptr(),
                stamps.as_mut_ptr(),
                instants.len() as u64,
                stamps.len() as u64,
                0.0,
                &mut code,
            )
        };
        // The first sample is there; an error comes again with the next pull.
        Ok(1 + values as usize / self.channels)
    }

    fn check(&self, code: i32, what: &'static str) -> Result<(), LslError> {
        let stream = self.stream.clone();
        match code {
            0 => Ok(()),
            TIMEOUT => Err(LslError::Timeout { stream, what }),
            LOST => Err(LslError::Lost { stream }),
            code => Err(LslError::Refused { stream, what, code }),
        }
    }
}
