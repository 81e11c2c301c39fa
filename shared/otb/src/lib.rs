//! The protocols of OT Bioelettronica's amplifiers over TCP: Muovi, Muovi+, Sessantaquattro+ and Quattrocento.
//!
//! ```text
//! Muovi, Sessantaquattro+   device ──dials in──▶ computer           Quattrocento   computer ──dials in──▶ device
//!
//! computer ── control word ([`Amplifier::start_word`]) ──▶ device
//! device   ── instants: all channels of one sampling time together, a counter among them ──▶ [`Decoder`] ──▶ mV, lost samples
//! ```
//!
//! No device sends times. The counter, one more at each instant, shows exactly which instants were lost. TCP reads do not
//! begin or end where instants do; the [`Decoder`] keeps what is left over.
//!
//! Sources: the vendor's MATLAB clients and protocol sheets, and public clients. Only the formats on which they agree are
//! offered: 16 bit samples. Nothing here was tried on the vendor's hardware.
#![forbid(unsafe_code)]

mod amplifier;
mod crc;
mod decoder;
mod quattrocento;
mod sessantaquattro;
mod settings;
mod width;

pub use amplifier::{Amplifier, ByteOrder, Dialling, Layout};
pub use crc::crc8;
pub use decoder::{Decoder, Instants, OutOfStep};
pub use quattrocento::{Quattrocento, QuattrocentoError};
pub use sessantaquattro::{Gain, GainError, Mode, Sessantaquattro, SessantaquattroError};
pub use settings::{Device, OtbSettings, OtbSettingsError};
pub use width::{WidthError, find_accessories, probe_bytes};
