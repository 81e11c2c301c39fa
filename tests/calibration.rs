//! The story of a stranger, with nobody there: badly recognised, calibrated, well recognised.

use std::path::Path;

use serde_json::Value;
use tendon_system_tests::{Ended, TendonBuilder};
