//! Tasks, and the samples of the simulated devices.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::channels::Device;
use crate::errors::{
    BAD_TASK, BAD_VALUE, NO_CHANNEL, NOT_STARTED, NOT_WHILE_RUNNING, NOT_YET, OVERRUN, RESERVED, Refusal,
    SMALL_BUFFER, UNPLUGGED,
};

/// Names the file whose word makes a fault: `unplugged`, `overrun`, `silent`. No file, no fault.
const CONTROL: &str = "DAQMX_EMULATOR_CONTROL";
/// The sine of a simulated device, Hz.
const SINE_HZ: f64 = 40.0;
/// Noise, as a share of the range.
const NOISE: f64 = 0.03;
/// From channel to channel, turns.
const SHIFT: f64 = 5.0 / 360.0;
/// The clock that rates are divided from, Hz.
const TIMEBASE_HZ: f64 = 80e6;
/// Time between two looks for samples.
const LOOK: Duration = Duration::from_micros(500);

/// A fault that was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    None,
    Unplugged,
    Overrun,
    /// No samples come any more.
    Silent,
}

/// The fault that the control file asks for.
pub fn fault() -> Fault {
    let Some(path) = std::env::var_os(CONTROL) else { return Fault::None };
    match std::fs::read_to_string(path).unwrap_or_default().trim() {
        "unplugged" => Fault::Unplugged,
        "overrun" => Fault::Overrun,
        "silent" => Fault::Silent,
        _ => Fault::None,
    }
}

/// An input of a task.
#[derive(Clone, Debug)]
pub struct Input {
    pub device: &'static Device,
    pub name: String,
    pub range_v: [f64; 2],
}

/// A task.
#[derive(Debug)]
pub struct Task {
    pub name: String,
    pub inputs: Vec<Input>,
    pub rate_hz: f64,
    pub buffer_samples: u64,
    started: Option<Instant>,
    /// Samples of each channel that were read.
    pub position: u64,
    noise: Xoshiro256PlusPlus,
}

/// All tasks of this process.
#[derive(Debug, Default)]
pub struct Driver {
    tasks: BTreeMap<usize, Task>,
    made: usize,
}

static DRIVER: Mutex<Driver> = Mutex::new(Driver { tasks: BTreeMap::new(), made: 0 });

/// The driver of this process.
pub fn driver() -> MutexGuard<'static, Driver> {
    // A task whose call broke off is as it was.
    DRIVER.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Driver {
    /// Makes a task and returns its number, which is never 0.
    pub fn create(&mut self, name: &str) -> usize {
        self.made += 1;
        let name = if name.is_empty() { format!("_unnamedTask<{}>", self.made - 1) } else { name.to_owned() };
        let task = Task {
            name,
            inputs: Vec::new(),
            rate_hz: 1000.0,
            buffer_samples: 0,
            started: None,
            position: 0,
            noise: Xoshiro256PlusPlus::seed_from_u64(self.made as u64),
        };
        self.tasks.insert(self.made, task);
        self.made
    }

    pub fn clear(&mut self, number: usize) -> Result<i32, Refusal> {
        self.tasks.remove(&number).map(|_| 0).ok_or(BAD_TASK)
    }

    pub fn task(&mut self, number: usize) -> Result<&mut Task, Refusal> {
        self.tasks.get_mut(&number).ok_or(BAD_TASK)
    }

    /// Starts a task, unless another one measures with a device of its.
    pub fn start(&mut self, number: usize) -> Result<i32, Refusal> {
        let task = self.tasks.get(&number).ok_or(BAD_TASK)?;
        if task.inputs.is_empty() {
            return Err(NO_CHANNEL);
        }
        let uses =
            |task: &Task, device: &Device| task.inputs.iter().any(|input| input.device.name == device.name);
        let is_taken = self.tasks.iter().any(|(other, running)| {
            *other != number
                && running.started.is_some()
                && task.inputs.iter().any(|input| uses(running, input.device))
        });
        if is_taken {
            return Err(RESERVED);
        }
        if fault() == Fault::Unplugged {
            return Err(UNPLUGGED);
        }
        let task = self.task(number)?;
        task.started = Some(Instant::now());
        task.position = 0;
        Ok(0)
    }
}

impl Task {
    pub fn is_running(&self) -> bool {
        self.started.is_some()
    }

    pub fn stop(&mut self) {
        self.started = None;
    }

    pub fn add(&mut self, inputs: Vec<Input>) -> Result<i32, Refusal> {
        if self.is_running() {
            return Err(NOT_WHILE_RUNNING);
        }
        self.inputs.extend(inputs);
        Ok(0)
    }

    /// Sets the rate to the nearest that the timebase gives, and the buffer as the driver chooses it.
    pub fn time(&mut self, rate_hz: f64, hint_samples: u64) -> Result<i32, Refusal> {
        if self.is_running() {
            return Err(NOT_WHILE_RUNNING);
        }
        let fastest_hz = self.inputs.iter().map(|input| input.device.fastest_hz).fold(f64::MAX, f64::min);
        if !(rate_hz > 0.0 && rate_hz <= fastest_hz) {
            return Err(BAD_VALUE);
        }
        self.rate_hz = TIMEBASE_HZ / (TIMEBASE_HZ / rate_hz).round();
        let by_rate = match rate_hz {
            ..=100.0 => 1_000,
            ..=10_000.0 => 10_000,
            ..=1_000_000.0 => 100_000,
            _ => 1_000_000,
        };
        self.buffer_samples = hint_samples.max(by_rate);
        Ok(0)
    }

    /// Samples of each channel acquired so far.
    pub fn acquired(&self) -> u64 {
        self.started.map_or(0, |started| (started.elapsed().as_secs_f64() * self.rate_hz) as u64)
    }

    /// Samples of each channel that can be read now.
    pub fn available(&self) -> Result<u64, Refusal> {
        if !self.is_running() {
            return Err(NOT_STARTED);
        }
        match fault() {
            Fault::Unplugged => return Err(UNPLUGGED),
            Fault::Overrun => return Err(OVERRUN),
            Fault::Silent => return Ok(0),
            Fault::None => {}
        }
        let available = self.acquired() - self.position;
        if available > self.buffer_samples { Err(OVERRUN) } else { Ok(available) }
    }

    /// Writes `samples` of each channel into `volts`, of which there are enough.
    fn fill(&mut self, samples: usize, by_scan: bool, volts: &mut [f64]) {
        let channels = self.inputs.len();
        for sample in 0..samples {
            let turns = (self.position + sample as u64) as f64 * SINE_HZ / self.rate_hz;
            for (channel, input) in self.inputs.iter().enumerate() {
                let [lowest, highest] = input.range_v;
                let noise = NOISE * (2.0 * self.noise.random::<f64>() - 1.0);
                let sine = (TAU * (turns + SHIFT * channel as f64)).sin() * (1.0 - NOISE);
                let place = if by_scan { sample * channels + channel } else { channel * samples + sample };
                volts[place] = (lowest + highest) / 2.0 + (highest - lowest) / 2.0 * (sine + noise);
            }
        }
        self.position += samples as u64;
    }
}

/// What is read, and how.
#[derive(Clone, Copy, Debug)]
pub struct Read {
    /// Of each channel; `None` for all there are.
    pub samples: Option<usize>,
    /// `None` for ever.
    pub timeout: Option<Duration>,
    pub by_scan: bool,
}

/// Waits for samples and writes them. On a time-out, what is there is written, and the second number says how many.
pub fn read(number: usize, read: Read, volts: &mut [f64]) -> (Result<i32, Refusal>, usize) {
    let begun = Instant::now();
    loop {
        let mut driver = driver();
        match driver.task(number).and_then(|task| Ok((task.available()?, task))) {
            Ok((available, task)) => {
                let available = usize::try_from(available).unwrap_or(usize::MAX);
                let wanted = read.samples.unwrap_or(available);
                let is_late = read.timeout.is_some_and(|timeout| begun.elapsed() >= timeout);
                if available >= wanted || is_late {
                    let samples = available.min(wanted);
                    if samples * task.inputs.len() > volts.len() {
                        return (Err(SMALL_BUFFER), 0);
                    }
                    task.fill(samples, read.by_scan, volts);
                    let outcome = if samples < wanted { Err(NOT_YET) } else { Ok(0) };
                    return (outcome, samples);
                }
            }
            Err(refusal) => return (Err(refusal), 0),
        }
        drop(driver);
        std::thread::sleep(LOOK);
    }
}
