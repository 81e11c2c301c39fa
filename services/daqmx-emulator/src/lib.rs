//! A stand-in for NI-DAQmx's library `libnidaqmx.so.1`, for trying Tendon, and NI's own Python client, without the driver.
//!
//! ```text
//! client ── DAQmx… (C) ──▶ exported functions (c_api, attributes) ──▶ Driver: tasks ──▶ Device: sine, noise, its clock
//!                                                                        ▲
//!                                       file named by DAQMX_EMULATOR_CONTROL: "unplugged", "overrun", "silent"
//! ```
//!
//! Its devices are a chassis `cDAQ1` with a module `cDAQ1Mod1` of four inputs, as in the paper, and `Dev1` with 80. As
//! NI's simulated devices they give a sine over the full range of each channel with 3 % of noise, shifted by 5 degrees from
//! channel to channel, in real time. A reader that is slower than its buffer gets NI's error, and so does one whose device
//! was unplugged. Reservations hold within a process only.
//!
//! Names, numbers and signatures are those of NI's header `NIDAQmx.h`. Its attribute getters are variadic in C; callers pass
//! the arguments of the getters here in the same registers on x86-64 and AArch64 under Linux.
#![allow(non_snake_case, reason = "the names are NI's")]

mod attributes;
mod c_api;
mod channels;
mod driver;
mod errors;
mod text;
