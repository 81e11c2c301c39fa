//! One run of a model on memory owned by others.
//!
//! ort's safe interface allocates names, maps and reference counts for every run, and cannot take a new input
//! address without doing so. The path of a sample must not allocate, and the window must be read in place, in
//! shared memory. So this one call uses ONNX Runtime's C interface directly.

use std::ffi::{CStr, CString, c_void};
use std::fmt;
use std::ptr::{NonNull, null, null_mut};

use ort::AsPointer;
use ort::memory::{AllocationDevice, AllocatorType, MemoryInfo, MemoryType};
use ort::session::Session;
use ort::sys;

/// Why a run could not be made, or failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum RunError {
    /// A window of another length than the model's.
    #[error("{found} samples instead of {expected}")]
    Length {
        /// Samples given.
        found: usize,
        /// Samples wanted.
        expected: usize,
    },
    /// ONNX Runtime's own word.
    #[error("{0}")]
    Runtime(String),
}

impl From<ort::Error> for RunError {
    fn from(error: ort::Error) -> RunError {
        RunError::Runtime(error.to_string())
    }
}

/// A session with everything a run needs, prepared in advance.
///
/// Fields are dropped in their order: the tensor before the memory that it lies over, the session last.
pub(crate) struct Runner {
    input_name: CString,
    output_name: CString,
    shape: Box<[i64]>,
    input_length: usize,
    /// Tensor over `outputs`.
    output_tensor: Tensor,
    outputs: Outputs,
    memory: MemoryInfo<'static>,
    session: Session,
}

impl fmt::Debug for Runner {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Runner").field("shape", &self.shape).finish_non_exhaustive()
    }
}

impl Runner {
    pub(crate) fn new(
        session: Session,
        [input_name, output_name]: [&str; 2],
        shape: &[i64],
        classes: usize,
    ) -> Result<Runner, RunError> {
        let memory = MemoryInfo::new(AllocationDevice::CPU, 0, AllocatorType::Device, MemoryType::Default)?;
        let name = |name: &str| CString::new(name).map_err(|error| RunError::Runtime(error.to_string()));
        let outputs = Outputs::new(classes);
        let bytes = classes * size_of::<f32>();
        // SAFETY: `outputs` owns its memory through a raw pointer, so that moving it into the runner touches neither
        // address nor validity; the runner drops the tensor first.
        let output_tensor =
            unsafe { Tensor::at(&memory, outputs.start.as_ptr().cast(), bytes, &[1, classes as i64]) }?;
        Ok(Runner {
            input_name: name(input_name)?,
            output_name: name(output_name)?,
            shape: shape.into(),
            input_length: shape.iter().product::<i64>() as usize,
            output_tensor,
            outputs,
            memory,
            session,
        })
    }

    /// Runs the model on `input`, a window or a sequence of windows, in place; returns the outputs.
    pub(crate) fn run(&mut self, input: &[f32]) -> Result<&[f32], RunError> {
        if input.len() != self.input_length {
            return Err(RunError::Length { found: input.len(), expected: self.input_length });
        }
        let address = input.as_ptr().cast_mut().cast();
        // SAFETY: ONNX Runtime only reads inputs; the tensor is dropped at the end of this function, before
        // the borrow of `input` ends.
        let tensor = unsafe { Tensor::at(&self.memory, address, size_of_val(input), &self.shape) }?;
        let input_names = [self.input_name.as_ptr()];
        let inputs = [tensor.0.cast_const()];
        let output_names = [self.output_name.as_ptr()];
        let mut outputs = [self.output_tensor.0];
        // SAFETY: the session and both tensors are alive; each array has as many elements as its count says;
        // the names end in NUL; without run options the defaults hold. `&mut self` keeps a second run, and whoever
        // reads the outputs of the last one, away from the output.
        let status = unsafe {
            (ort::api().Run)(
                self.session.ptr().cast_mut(),
                null(),
                input_names.as_ptr(),
                inputs.as_ptr(),
                1,
                output_names.as_ptr(),
                1,
                outputs.as_mut_ptr(),
            )
        };
        check(status)?;
        Ok(self.outputs.values())
    }
}

/// Memory that ONNX Runtime writes a model's outputs to. It is owned through a raw pointer, not as a box: a box that
/// is moved says that nobody else points to its content, and the tensor does.
struct Outputs {
    start: NonNull<f32>,
    length: usize,
}

impl Outputs {
    fn new(length: usize) -> Outputs {
        let values: &'static mut [f32] = Box::leak(vec![0.0; length].into_boxed_slice());
        Outputs { length, start: NonNull::from(values).cast() }
    }

    /// What the last run wrote.
    fn values(&self) -> &[f32] {
        // SAFETY: `start` is that of `length` initialised values, which live until `self` is dropped. Only a run
        // writes to them, and `Runner::run` borrows the runner exclusively.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.length) }
    }
}

impl Drop for Outputs {
    fn drop(&mut self) {
        let values = std::ptr::slice_from_raw_parts_mut(self.start.as_ptr(), self.length);
        // SAFETY: the slice is the one that `new` leaked; it is taken back once, here, and the tensor over it is gone.
        drop(unsafe { Box::from_raw(values) });
    }
}

/// A tensor over memory owned by somebody else.
struct Tensor(*mut sys::OrtValue);

impl Tensor {
    /// # Safety
    ///
    /// `values` must point to `bytes` bytes of f32 that live as long as the tensor is used, and that nobody else writes
    /// to or, unless it is only used as an input, reads from meanwhile.
    unsafe fn at(
        memory: &MemoryInfo<'_>,
        values: *mut c_void,
        bytes: usize,
        shape: &[i64],
    ) -> Result<Tensor, RunError> {
        let mut tensor = null_mut();
        // SAFETY: `memory` and `shape` are alive for the call, `values` by the caller's promise, and `tensor`
        // receives the pointer.
        let status = unsafe {
            (ort::api().CreateTensorWithDataAsOrtValue)(
                memory.ptr(),
                values,
                bytes,
                shape.as_ptr(),
                shape.len(),
                sys::ONNXTensorElementDataType::ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT,
                &raw mut tensor,
            )
        };
        check(status)?;
        Ok(Tensor(tensor))
    }
}

impl Drop for Tensor {
    fn drop(&mut self) {
        // SAFETY: the pointer came from ONNX Runtime and is released once, here.
        unsafe { (ort::api().ReleaseValue)(self.0) }
    }
}

/// Turns ONNX Runtime's status into a result.
fn check(status: sys::OrtStatusPtr) -> Result<(), RunError> {
    if status.0.is_null() {
        return Ok(());
    }
    // SAFETY: a status that is not null is a live error object with a NUL-terminated message; it is ours to
    // release, once, after the message was copied.
    unsafe {
        let message = CStr::from_ptr((ort::api().GetErrorMessage)(status.0)).to_string_lossy().into_owned();
        (ort::api().ReleaseStatus)(status.0);
        Err(RunError::Runtime(message))
    }
}
