//! Folders and names that one user has to itself.
//!
//! ```text
//! runtime_folder   $XDG_RUNTIME_DIR/tendon            else /tmp/tendon-UID       gone after a reboot
//! state_folder     $XDG_STATE_HOME/tendon             else ~/.local/state/tendon lasting
//! data_folder      $XDG_DATA_HOME/tendon              else ~/.local/share/tendon what the user keeps
//! SharedFolder     notes that all users can read, and that only their writer can change
//! Claim            a socket name in the kernel        one holder, gone with its process
//! ```
//!
//! Anybody can create `/tmp/tendon-1000` before user 1000 does, and put links or forged files in it. So a folder is
//! used only if it is a real directory that belongs to this user and that nobody else may enter. All files in it are
//! opened relative to the checked directory, never through a link, and are checked again once open.
#![forbid(unsafe_code)]

mod claim;
mod folder;
mod shared;

pub use claim::{Claim, ClaimError, Holder, claimed_names, holding_user};
pub use folder::{
    PathError, PrivateFolder, arm_record_folder, data_folder, runtime_folder, runtime_folders, state_folder,
    user_name,
};
pub use shared::{SharedFolder, shared_arm_folder};
