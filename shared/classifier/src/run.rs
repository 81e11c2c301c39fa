//! One run of a model on memory that is not ours.
//!
//! ort's safe interface allocates names, maps and reference counts for every run, and cannot take a new
//! input address without doing so. The path of a sample must not allocate, and the window must be read where
//! it lies, in shared memory; so the one call that does this goes to ONNX Runtime's C interface directly.

use std::ffi::{CStr, CString};
use std::fmt;
use std::ptr::{NonNull, null, null_mut};

use ort::AsPointer;
use ort::memory::{AllocationDevice, AllocatorType, MemoryInfo, MemoryType};
use ort::session::Session;
use ort::sys;

/// A session with everything that a run needs, made beforehand.
pub(crate) struct Runner {
    input_name: CString,
    output_name: CString,
    shape: Box<[i64]>,
    input_length: usize,
    /// Tensor over `outputs`; fields are dropped in this order.
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
    ) -> Result<Runner, String> {
        let memory = MemoryInfo::new(AllocationDevice::CPU, 0, AllocatorType::Device, MemoryType::Default)
            .map_err(|error| error.to_string())?;
        let name = |name: &str| CString::new(name).map_err(|error| error.to_string());
        let outputs = Outputs::new(classes);
        // SAFETY: the memory belongs to `outputs`, which the runner drops after the tensor.
        let output_tensor = unsafe { Tensor::at(&memory, outputs.0, &[1, classes as i64]) }?;
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

    /// Runs the model on `input`, a window or a sequence of such, where it lies; returns the outputs.
    pub(crate) fn run(&mut self, input: &[f32]) -> Result<&[f32], String> {
        if input.len() != self.input_length {
            return Err(format!("{} samples instead of {}", input.len(), self.input_length));
        }
        // SAFETY: ONNX Runtime only reads inputs; the tensor is dropped at the end of this function, before
        // the borrow of `input` ends.
        let tensor = unsafe { Tensor::at(&self.memory, NonNull::from(input), &self.shape) }?;
        let input_names = [self.input_name.as_ptr()];
        let inputs = [tensor.0.cast_const()];
        let output_names = [self.output_name.as_ptr()];
        let mut outputs = [self.output_tensor.0];
        // SAFETY: the session and both tensors are alive; each array has as many elements as its count says;
        // the names end in NUL; without run options the defaults hold. `&mut self` keeps a second run away
        // from the output.
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
        // SAFETY: the memory is initialised and lives as long as `self`; ONNX Runtime writes to it in a run only,
        // and `&mut self` keeps a run away as long as the borrow lasts.
        Ok(unsafe { self.outputs.0.as_ref() })
    }
}

/// Memory that ONNX Runtime writes to. It is owned by its address, because a `Box` that is moved, as it is into the
/// runner, may not be reached by a pointer taken before.
struct Outputs(NonNull<[f32]>);

impl Outputs {
    fn new(length: usize) -> Outputs {
        Outputs(NonNull::from(Box::leak(vec![0.0; length].into_boxed_slice())))
    }
}

impl Drop for Outputs {
    fn drop(&mut self) {
        // SAFETY: the pointer came from a box that was leaked, and is given back once, here.
        drop(unsafe { Box::from_raw(self.0.as_ptr()) });
    }
}

/// A tensor over memory of somebody else.
struct Tensor(*mut sys::OrtValue);

impl Tensor {
    /// # Safety
    ///
    /// `values` must live as long as the tensor is used, and, unless the tensor is used as an input only, which is
    /// never written to, must be writable.
    unsafe fn at(memory: &MemoryInfo<'_>, values: NonNull<[f32]>, shape: &[i64]) -> Result<Tensor, String> {
        let mut tensor = null_mut();
        // SAFETY: `memory` and `shape` are alive for the call, `values` by the caller's promise, and `tensor`
        // receives the pointer.
        let status = unsafe {
            (ort::api().CreateTensorWithDataAsOrtValue)(
                memory.ptr(),
                values.as_ptr().cast(),
                values.len() * size_of::<f32>(),
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
fn check(status: sys::OrtStatusPtr) -> Result<(), String> {
    if status.0.is_null() {
        return Ok(());
    }
    // SAFETY: a status that is not null is a live error object with a NUL-terminated message; it is ours to
    // release, once, after the message was copied.
    unsafe {
        let message = CStr::from_ptr((ort::api().GetErrorMessage)(status.0)).to_string_lossy().into_owned();
        (ort::api().ReleaseStatus)(status.0);
        Err(message)
    }
}
