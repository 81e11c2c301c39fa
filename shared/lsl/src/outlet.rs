//! Giving streams.

use crate::library::{Lsl, OutletHandle, c_text};
use crate::{ChannelFacts, LslError};

/// liblsl's numbers of formats.
const FLOAT32: i32 = 1;
const TEXT: i32 = 3;
/// Seconds (or hundreds of samples) that liblsl keeps for a slow reader, who then loses the oldest.
const KEPT: i32 = 30;

/// What a stream is called and holds.
#[derive(Clone, Debug)]
pub struct StreamDescription {
    /// Its name.
    pub name: String,
    /// Its content type.
    pub content_type: String,
    /// Names the source; the same after a restart, so that readers find it again.
    pub source_id: String,
    /// Sampling rate, Hz; 0 if it is irregular.
    pub sample_rate_hz: f64,
    /// Its channels.
    pub channels: Vec<ChannelFacts>,
}

#[derive(Debug)]
struct Handle {
    lsl: Lsl,
    outlet: OutletHandle,
}

impl Drop for Handle {
    fn drop(&mut self) {
        // SAFETY: the handle is this value's own and not used after.
        unsafe { (self.lsl.functions.destroy_outlet)(self.outlet) };
    }
}

impl Handle {
    fn new(lsl: Lsl, description: &StreamDescription, format: i32) -> Result<Handle, LslError> {
        let StreamDescription { name, content_type, source_id, sample_rate_hz, channels } = description;
        let refused = || LslError::Refused { stream: name.clone(), what: "an outlet", code: 0 };
        let functions = lsl.functions;
        let (c_name, c_type, c_id) = (c_text(name)?, c_text(content_type)?, c_text(source_id)?);
        let texts = channels
            .iter()
            .map(|channel| {
                Ok([c_text(&channel.label)?, c_text(&channel.unit)?, c_text(&channel.content_type)?])
            })
            .collect::<Result<Vec<_>, LslError>>()?;
        let count = i32::try_from(channels.len()).map_err(|_| refused())?;
        // SAFETY: all texts live through the calls, and liblsl copies them. The description is freed here alone; the outlet has
        // a copy of it.
        let outlet = unsafe {
            let (name, content_type, id) = (c_name.as_ptr(), c_type.as_ptr(), c_id.as_ptr());
            let info = (functions.create_streaminfo)(name, content_type, count, *sample_rate_hz, format, id);
            if info.is_null() {
                return Err(refused());
            }
            let list = (functions.append_child)((functions.get_desc)(info), c"channels".as_ptr());
            for [label, unit, content_type] in &texts {
                let channel = (functions.append_child)(list, c"channel".as_ptr());
                (functions.append_child_value)(channel, c"label".as_ptr(), label.as_ptr());
                (functions.append_child_value)(channel, c"unit".as_ptr(), unit.as_ptr());
                (functions.append_child_value)(channel, c"type".as_ptr(), content_type.as_ptr());
            }
            let outlet = (functions.create_outlet)(info, 0, KEPT);
            (functions.destroy_streaminfo)(info);
            outlet
        };
        if outlet.is_null() {
            return Err(refused());
        }
        Ok(Handle { lsl, outlet })
    }
}

/// A stream of numbers. Nobody who reads it holds it up.
#[derive(Debug)]
pub struct Outlet {
    handle: Handle,
    channels: usize,
}

impl Outlet {
    /// Gives a stream of this description from now on.
    ///
    /// # Errors
    ///
    /// [`LslError::Refused`], or [`LslError::Text`] when a text holds a zero byte.
    pub fn new(lsl: Lsl, description: &StreamDescription) -> Result<Outlet, LslError> {
        let handle = Handle::new(lsl, description, FLOAT32)?;
        Ok(Outlet { handle, channels: description.channels.len() })
    }

    /// Gives samples, `[samples × channels]`, whose newest one was captured at `newest_s` on our clock ([`Lsl::clock_s`]).
    ///
    /// # Panics
    ///
    /// When they are not of all channels.
    pub fn push(&mut self, instants: &[f32], newest_s: f64) {
        assert!(instants.len().is_multiple_of(self.channels), "samples of all channels");
        let Handle { lsl, outlet } = &self.handle;
        // SAFETY: as many values are read as there are. liblsl can refuse the number of values only.
        unsafe { (lsl.functions.push_chunk_ft)(*outlet, instants.as_ptr(), instants.len() as u64, newest_s) };
    }

    /// Whether anybody reads it.
    pub fn has_readers(&self) -> bool {
        // SAFETY: the handle is valid.
        unsafe { (self.handle.lsl.functions.have_consumers)(self.handle.outlet) != 0 }
    }
}

/// A stream of texts in one channel, such as markers.
#[derive(Debug)]
pub struct TextOutlet {
    handle: Handle,
}

impl TextOutlet {
    /// Gives a stream of this description, whose first channel is the only one, from now on.
    ///
    /// # Errors
    ///
    /// As [`Outlet::new`].
    pub fn new(lsl: Lsl, description: &StreamDescription) -> Result<TextOutlet, LslError> {
        let one = StreamDescription {
            channels: description.channels.iter().take(1).cloned().collect(),
            ..description.clone()
        };
        Ok(TextOutlet { handle: Handle::new(lsl, &one, TEXT)? })
    }

    /// Gives a text of this time.
    ///
    /// # Errors
    ///
    /// [`LslError::Text`] when it holds a zero byte.
    pub fn push(&mut self, text: &str, at_s: f64) -> Result<(), LslError> {
        let text = c_text(text)?;
        let Handle { lsl, outlet } = &self.handle;
        // SAFETY: one text is read, which lives through the call and is copied.
        unsafe { (lsl.functions.push_sample_strt)(*outlet, &text.as_ptr(), at_s) };
        Ok(())
    }
}
