//! The functions of liblsl, loaded at run time. Their types are those of `include/lsl/*.h` of liblsl 1.17.

use std::ffi::{CStr, CString, c_char, c_ulong, c_void};
use std::path::Path;
use std::sync::OnceLock;

use libloading::Library;

use crate::LslError;

/// A stream's description, an element of it, an inlet, an outlet: liblsl's handles.
pub(crate) type Info = *mut c_void;
pub(crate) type Element = *mut c_void;
pub(crate) type InletHandle = *mut c_void;
pub(crate) type OutletHandle = *mut c_void;
type Text = *const c_char;

/// What liblsl says when its log is not configured: errors only, and not the addresses of every network card.
const QUIET_LOG: &CStr = c"[log]\nlevel = -2\n";
/// Files that configure liblsl, beside the one that `LSLAPICFG` names.
const CONFIGURATIONS: [&str; 2] = ["lsl_api.cfg", "/etc/lsl_api/lsl_api.cfg"];
/// The same in the user's home.
const HOME_CONFIGURATION: &str = "lsl_api/lsl_api.cfg";

macro_rules! functions {
    ($($name:ident($($argument:ty),*) $(-> $result:ty)?;)+) => {
        /// Functions of liblsl, by their names without `lsl_`.
        #[derive(Debug)]
        pub(crate) struct Functions {
            $(pub(crate) $name: unsafe extern "C" fn($($argument),*) $(-> $result)?,)+
        }

        impl Functions {
            fn of(library: &Library) -> Result<Functions, libloading::Error> {
                Ok(Functions {
                    // SAFETY: the types are those of liblsl's headers. The pointers outlive no library: it is never unloaded.
                    $($name: *unsafe { library.get(concat!("lsl_", stringify!($name), "\0").as_bytes()) }?,)+
                })
            }
        }
    };
}

functions! {
    library_version() -> i32;
    local_clock() -> f64;
    resolve_all(*mut Info, u32, f64) -> i32;
    resolve_bypred(*mut Info, u32, Text, i32, f64) -> i32;
    create_streaminfo(Text, Text, i32, f64, i32, Text) -> Info;
    destroy_streaminfo(Info);
    get_desc(Info) -> Element;
    get_name(Info) -> Text;
    get_type(Info) -> Text;
    get_source_id(Info) -> Text;
    get_uid(Info) -> Text;
    get_created_at(Info) -> f64;
    get_hostname(Info) -> Text;
    get_channel_count(Info) -> i32;
    get_channel_format(Info) -> i32;
    get_nominal_srate(Info) -> f64;
    child(Element, Text) -> Element;
    next_sibling_n(Element, Text) -> Element;
    append_child(Element, Text) -> Element;
    append_child_value(Element, Text, Text) -> Element;
    empty(Element) -> i32;
    child_value_n(Element, Text) -> Text;
    create_inlet(Info, i32, i32, i32) -> InletHandle;
    destroy_inlet(InletHandle);
    get_fullinfo(InletHandle, f64, *mut i32) -> Info;
    open_stream(InletHandle, f64, *mut i32);
    time_correction(InletHandle, f64, *mut i32) -> f64;
    pull_sample_f(InletHandle, *mut f32, i32, f64, *mut i32) -> f64;
    pull_chunk_f(InletHandle, *mut f32, *mut f64, c_ulong, c_ulong, f64, *mut i32) -> c_ulong;
    create_outlet(Info, i32, i32) -> OutletHandle;
    destroy_outlet(OutletHandle);
    push_chunk_ft(OutletHandle, *const f32, c_ulong, f64) -> i32;
    push_sample_strt(OutletHandle, *const Text, f64) -> i32;
    have_consumers(OutletHandle) -> i32;
}

/// liblsl, which stays loaded for the life of the process.
#[derive(Clone, Copy, Debug)]
pub struct Lsl {
    pub(crate) functions: &'static Functions,
}

impl Lsl {
    /// Loads liblsl from this file, as [`crate::find_library`] found it. What was loaded before stays: a process has one.
    ///
    /// # Errors
    ///
    /// [`LslError::Library`] when it is no liblsl.
    pub fn load(path: &Path) -> Result<Lsl, LslError> {
        static LOADED: OnceLock<Functions> = OnceLock::new();
        if let Some(functions) = LOADED.get() {
            return Ok(Lsl { functions });
        }
        let refused =
            |error: libloading::Error| LslError::Library { path: path.to_owned(), reason: error.to_string() };
        // SAFETY: its initialisers run. It is a file that the user named or that scripts/fetch-libraries fetched with its hash
        // checked, and liblsl's initialisers only set up its own variables.
        let library = unsafe { Library::new(path) }.map_err(refused)?;
        let functions = Functions::of(&library).map_err(refused)?;
        if !is_configured() {
            keep_quiet(&library);
        }
        // Its threads may still run when the process ends.
        std::mem::forget(library);
        Ok(Lsl { functions: LOADED.get_or_init(|| functions) })
    }

    /// Its version, such as `1.17`.
    pub fn version(self) -> String {
        // SAFETY: a plain function without arguments.
        let version = unsafe { (self.functions.library_version)() };
        format!("{}.{}", version / 100, version % 100)
    }

    /// Now, on the clock of time stamps: CLOCK_MONOTONIC in seconds.
    pub fn clock_s(self) -> f64 {
        // SAFETY: a plain function without arguments.
        unsafe { (self.functions.local_clock)() }
    }
}

/// Whether the user configures liblsl.
fn is_configured() -> bool {
    let home = std::env::home_dir().map(|home| home.join(HOME_CONFIGURATION));
    std::env::var_os("LSLAPICFG").is_some()
        || CONFIGURATIONS.iter().any(|file| Path::new(file).exists())
        || home.is_some_and(|file| file.exists())
}

/// Lets liblsl say errors only. One that is too old for that says more than anybody reads.
fn keep_quiet(library: &Library) {
    type SetConfiguration = unsafe extern "C" fn(Text);
    // SAFETY: the type is that of liblsl's header.
    if let Ok(set) = unsafe { library.get::<SetConfiguration>(b"lsl_set_config_content\0") } {
        // SAFETY: it copies the text, and nothing else was called before.
        unsafe { set(QUIET_LOG.as_ptr()) };
    }
}

/// A text of liblsl; a null pointer is an empty one.
///
/// # Safety
///
/// The pointer is null, or of a text that ends with a zero byte and lives through the call.
pub(crate) unsafe fn text(pointer: Text) -> String {
    if pointer.is_null() {
        return String::new();
    }
    // SAFETY: the caller's.
    unsafe { CStr::from_ptr(pointer) }.to_string_lossy().into_owned()
}

/// A text for liblsl.
pub(crate) fn c_text(text: &str) -> Result<CString, LslError> {
    CString::new(text).map_err(|_| LslError::Text { text: text.replace('\0', "\\0") })
}
