//! The source, in the loop that acquires.

use std::os::fd::AsFd;

use nix::errno::Errno;
use tendon_process::{STALE_NS, SignalDescription, StageProcess, Wake, with_causes};
use tendon_source::{
    BlockAssembler, Choice, Chunk, DeviceClock, LossByTime, Next, Offer, Source, SourceError, Wait,
};
use tendon_transport::now_ns;

use crate::connect::{Connecting, Connector, Event};
use crate::error::{ConnectError, LinkError};
use crate::{Instants, Link};

/// How long the device may take to be there when the program starts, ns. A session waits a little longer.
const CONNECT_NS: u64 = 50_000_000_000;
/// A connection without samples for so long is lost, ns: Wi-Fi that is gone says nothing.
const SILENCE_NS: u64 = 500_000_000;
/// Samples that are too old to act upon for so long show that the connection lags behind, ns.
const LAG_NS: u64 = 2_000_000_000;
/// Samples that come so much later than before were lost, if the device does not say which, ns.
const LOST_NS: u64 = 20_000_000;
/// Bytes of a read.
const READ_BYTES: usize = 1 << 16;

/// A source behind a connection that comes and goes.
pub struct LinkedSource {
    connecting: Connecting,
    offer: Offer,
    name: String,
    link: Option<Link>,
    stream: SampleStream,
    buffer: Vec<u8>,
    /// Whether a block was just delivered, and there may be another.
    may_have_more: bool,
    /// What was said last of tries to connect.
    said: String,
    /// Whether there was a connection before.
    was_lost: bool,
    /// Whether it was said that samples come at another rate.
    rate_was_said: bool,
}

impl std::fmt::Debug for LinkedSource {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("LinkedSource").field("name", &self.name).finish_non_exhaustive()
    }
}

impl LinkedSource {
    /// Waits until a device is connected that has what the session wants, and says meanwhile what is missing. `None` if the
    /// process is told to stop before.
    ///
    /// # Errors
    ///
    /// [`LinkError`] when nobody comes in time, or who comes will not do.
    pub fn open(
        process: &mut StageProcess,
        connector: impl Connector,
    ) -> Result<Option<LinkedSource>, LinkError> {
        let connecting = Connecting::start(connector).map_err(LinkError::Thread)?;
        let Some((offer, name)) = first_connection(process, &connecting)? else { return Ok(None) };
        let settings = &process.config.acquisition;
        let choice = offer.choose(settings)?;
        let assembler = BlockAssembler::new(settings.channels, settings.block_samples, offer.sample_rate_hz);
        let stream = SampleStream::new(&offer, choice, assembler);
        Ok(Some(LinkedSource {
            connecting,
            offer,
            name,
            link: None,
            stream,
            buffer: vec![0; READ_BYTES],
            may_have_more: false,
            said: String::new(),
            was_lost: false,
            rate_was_said: false,
        }))
    }

    /// What to tell the user when it is ready.
    pub fn description(&self) -> String {
        let SignalDescription { channels, unit } = self.signal();
        let unit = if unit.is_empty() { String::new() } else { format!(" in {unit}") };
        format!("{}, {} Hz, channels {}{unit}", self.name, self.offer.sample_rate_hz, channels.join(", "))
    }

    /// The channels of the session, by name, and their unit.
    pub fn signal(&self) -> &SignalDescription {
        &self.stream.choice.signal
    }

    /// Reads once; says what is wrong if something is.
    fn read(&mut self, now_ns: u64) -> Option<String> {
        let link = self.link.as_mut()?;
        match nix::unistd::read(&link.stream, &mut self.buffer) {
            Ok(0) => return Some("the connection was closed".to_owned()),
            Ok(count) => {
                let stream = &mut self.stream;
                let mut take = |run: Instants<'_>| stream.take(run, now_ns);
                if let Err(error) = link.decoder.push(&self.buffer[..count], &mut take) {
                    return Some(with_causes(error.as_ref()));
                }
            }
            Err(Errno::EAGAIN | Errno::EINTR) => {}
            Err(error) => return Some(format!("the connection broke ({})", error.desc())),
        }
        self.say_other_rate();
        self.stream.failure(now_ns)
    }

    /// Samples that come more slowly than they should seem to come later and later, and nobody could see why the arm stops.
    fn say_other_rate(&mut self) {
        let Some(share) = self.stream.clock.other_rate().filter(|_| !self.rate_was_said) else { return };
        self.rate_was_said = true;
        let rate_hz = self.offer.sample_rate_hz;
        tracing::warn!(
            "{}: for 20 s its samples have come at {:.1} Hz instead of {rate_hz} Hz. Does the network keep up? If so, that is its \
             real rate: set acquisition.sample_rate_hz to it, and in a program of your own rate_hz",
            self.name,
            share * rate_hz
        );
    }

    fn lose(&mut self, reason: &str) {
        tracing::warn!(
            "{}: {reason}. It is looked for; is it switched on, in reach and connected?",
            self.name
        );
        self.link = None;
        self.was_lost = true;
        self.said.clear();
        self.connecting.ask();
    }

    /// Says what goes wrong at every try, each second, but once.
    fn say_once(&mut self, text: String) {
        if text != self.said {
            tracing::warn!("{text}");
            self.said = text;
        }
    }

    fn take_event(&mut self, now_ns: u64) {
        match self.connecting.event() {
            None => {}
            Some(Event::Connected { name, .. }) => self.name = name,
            Some(Event::Failed(error)) => self.say_once(with_causes(&error)),
            Some(Event::Link(link)) if link.offer != self.offer => {
                let text = format!(
                    "{}: other channels, units or rate than before: start the session again",
                    link.name
                );
                self.say_once(text);
                self.connecting.ask();
            }
            Some(Event::Link(link)) => {
                if self.was_lost {
                    tracing::warn!("{} is back", self.name);
                }
                self.stream.begin(link.shows_losses, now_ns);
                self.link = Some(link);
            }
        }
    }
}

/// Waits for the first device. `None` when told to stop.
fn first_connection(
    process: &mut StageProcess,
    connecting: &Connecting,
) -> Result<Option<(Offer, String)>, LinkError> {
    let until_ns = now_ns() + CONNECT_NS;
    let mut last: Option<ConnectError> = None;
    let mut orders = Vec::new();
    let connected = loop {
        match connecting.event() {
            Some(Event::Connected { offer, name }) => break Some((offer, name)),
            Some(Event::Failed(unfit @ ConnectError::Unfit(_))) => return Err(unfit.into()),
            Some(Event::Failed(error)) => {
                let text = with_causes(&error);
                if last.as_ref().is_none_or(|before| with_causes(before) != text) {
                    tracing::warn!("{text}");
                }
                last = Some(error);
                continue;
            }
            Some(Event::Link(_)) => unreachable!("no connection was asked for"),
            None => {}
        }
        match process.control.wait(Some(connecting.wakes().as_fd()), Some(until_ns))? {
            Wake::Stop => break None,
            Wake::Order(order) => orders.push(order),
            Wake::Message => {}
            Wake::Deadline => {
                return Err(last
                    .unwrap_or_else(|| ConnectError::not_yet("the device did not connect"))
                    .into());
            }
        }
    };
    process.control.keep(orders);
    Ok(connected)
}

impl Source for LinkedSource {
    fn start(&mut self) -> Result<(), SourceError> {
        self.connecting.ask();
        Ok(())
    }

    fn wait(&self) -> Wait<'_> {
        match &self.link {
            _ if self.may_have_more => Wait::Nothing,
            Some(link) => Wait::ReadableUntil(link.stream.as_fd(), self.stream.newest_ns + SILENCE_NS),
            None => Wait::Readable(self.connecting.wakes().as_fd()),
        }
    }

    fn next_block(&mut self, samples: &mut [f32]) -> Result<Next, SourceError> {
        let mut block = self.stream.assembler.next_block(samples);
        if block.is_none() {
            let now_ns = now_ns();
            match self.read(now_ns) {
                Some(reason) => self.lose(&reason),
                None if self.link.is_none() => self.take_event(now_ns),
                None => {}
            }
            block = self.stream.assembler.next_block(samples);
        }
        self.may_have_more = block.is_some();
        Ok(block.map_or(Next::NotYet, Next::Block))
    }

    fn clock_drift_ppm(&self) -> Option<f64> {
        self.stream.clock.drift_ppm()
    }
}

/// The samples of all connections of a session, on its one count.
struct SampleStream {
    choice: Choice,
    assembler: BlockAssembler,
    sample_ns: f64,
    channels: usize,
    clock: DeviceClock,
    /// Samples of the chosen channels.
    chosen: Vec<f32>,
    /// Sample of the session minus sample of the connection; `None` until its first sample is there.
    offset: Option<i64>,
    /// Of the session: the sample after the newest, and when the newest was captured.
    next_sample: u64,
    captured_ns: u64,
    /// When the newest sample was received, or the connection began.
    newest_ns: u64,
    /// When a sample was last received in time.
    timely_ns: u64,
    loss: Option<LossByTime>,
    /// Lateness of the newest sample.
    lateness_ns: u64,
}

impl SampleStream {
    fn new(offer: &Offer, choice: Choice, assembler: BlockAssembler) -> SampleStream {
        SampleStream {
            choice,
            assembler,
            sample_ns: 1e9 / offer.sample_rate_hz,
            channels: offer.channels.len(),
            clock: DeviceClock::default(),
            chosen: Vec::new(),
            offset: None,
            next_sample: 0,
            captured_ns: 0,
            newest_ns: 0,
            timely_ns: 0,
            loss: None,
            lateness_ns: 0,
        }
    }

    /// A connection begins.
    fn begin(&mut self, shows_losses: bool, now_ns: u64) {
        self.clock = DeviceClock::default();
        self.offset = None;
        self.newest_ns = now_ns;
        self.timely_ns = now_ns;
        self.loss = (!shows_losses).then(|| LossByTime::new(LOST_NS));
    }

    /// Takes samples that were received now.
    fn take(&mut self, run: Instants<'_>, received_ns: u64) {
        let samples = (run.instants.len() / self.channels) as u64;
        if samples == 0 {
            return;
        }
        let connection_ns = |sample: u64| (sample as f64 * self.sample_ns) as u64;
        let end = run.first_sample + samples;
        let offset = match self.offset {
            Some(offset) => offset,
            None => {
                let captured_ns = received_ns.saturating_sub(connection_ns(samples));
                let first_sample = self.next_sample + self.samples_since(captured_ns);
                *self.offset.insert(first_sample as i64 - run.first_sample as i64)
            }
        };
        let on_session = |sample: u64| (sample as i64 + offset) as u64;
        // By the session's count, which has the losses in it that the device does not show.
        let captured_ns = self.clock.captured_ns(connection_ns(on_session(end)), received_ns);
        self.lateness_ns = received_ns - captured_ns;
        if self.lateness_ns <= STALE_NS {
            self.timely_ns = received_ns;
        }
        self.newest_ns = received_ns;
        self.next_sample = on_session(end);
        self.captured_ns = captured_ns;
        self.chosen.clear();
        self.choice.take(run.instants, &mut self.chosen);
        let first_sample = on_session(run.first_sample);
        self.assembler.push(Chunk { first_sample, captured_ns, instants: &self.chosen });
        let lost_ns = self.loss.as_mut().map_or(0, |loss| loss.observe(received_ns, self.lateness_ns));
        self.offset = Some(offset + (lost_ns as f64 / self.sample_ns).round() as i64);
    }

    /// Samples that were missed from the newest one until `captured_ns`.
    fn samples_since(&self, captured_ns: u64) -> u64 {
        if self.next_sample == 0 {
            return 0;
        }
        let missing_ns = captured_ns.saturating_sub(self.captured_ns) as f64;
        ((missing_ns / self.sample_ns).round() as u64).saturating_sub(1).max(1)
    }

    /// Why the connection is of no use any more, if it is not.
    fn failure(&self, now_ns: u64) -> Option<String> {
        if now_ns.saturating_sub(self.newest_ns) >= SILENCE_NS {
            return Some("no samples for 0.5 s".to_owned());
        }
        if now_ns.saturating_sub(self.timely_ns) >= LAG_NS {
            let lateness_s = self.lateness_ns as f64 * 1e-9;
            return Some(format!("its samples come {lateness_s:.1} s late, and are too old to act upon"));
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use tendon_config::AcquisitionSettings;
    use tendon_source::OfferedChannel;

    use super::*;

    const RATE_HZ: f64 = 1000.0;
    const MS: u64 = 1_000_000;

    fn stream() -> SampleStream {
        let channel = |name: &str| OfferedChannel { name: name.into(), unit: "mV".into(), is_emg: true };
        let offer = Offer { sample_rate_hz: RATE_HZ, channels: vec![channel("flexor"), channel("extensor")] };
        let settings = AcquisitionSettings {
            channels: 1,
            sample_rate_hz: RATE_HZ,
            channel_selection: Some(vec!["extensor".into()]),
            ..AcquisitionSettings::default()
        };
        let choice = offer.choose(&settings).unwrap();
        SampleStream::new(&offer, choice, BlockAssembler::new(1, 10, RATE_HZ))
    }

    /// Ten samples from `first_sample`, received at `ms`; gives first sample, number and value of the blocks made of them.
    fn push(stream: &mut SampleStream, first_sample: u64, ms: u64) -> Vec<(u64, usize, f32)> {
        let instants: Vec<f32> =
            (first_sample..first_sample + 10).flat_map(|sample| [-1.0, sample as f32]).collect();
        stream.take(Instants { first_sample, instants: &instants }, ms * MS);
        let mut out = [0.0; 10];
        std::iter::from_fn(|| {
            let block = stream.assembler.next_block(&mut out)?;
            Some((block.first_sample, block.samples, out[0]))
        })
        .collect()
    }

    #[test]
    fn samples_count_from_the_first_one_whatever_the_device_counts() {
        let mut stream = stream();
        stream.begin(true, 5000 * MS);
        assert_eq!(push(&mut stream, 777, 5010), [(0, 10, 777.0)]);
        assert_eq!(push(&mut stream, 790, 5023), [(13, 10, 790.0)]);
    }

    #[test]
    fn a_new_connection_continues_the_count_with_the_lost_time_in_it() {
        let mut stream = stream();
        stream.begin(true, 5000 * MS);
        push(&mut stream, 0, 5010);
        stream.begin(true, 7000 * MS);
        let blocks = push(&mut stream, 40, 7010);
        let [(first_sample, 10, 40.0)] = blocks[..] else { panic!("{blocks:?}") };
        assert!((1998..=2001).contains(&first_sample), "{first_sample}");
    }

    #[test]
    fn silence_and_samples_that_lag_behind_are_failures() {
        let mut stream = stream();
        stream.begin(true, 5000 * MS);
        assert_eq!(stream.failure(5499 * MS), None);
        assert!(stream.failure(5500 * MS).unwrap().contains("0.5 s"));
        push(&mut stream, 0, 5010);
        // From here on everything comes 1 s late.
        for step in 1..=200 {
            push(&mut stream, step * 10, 6010 + step * 10);
        }
        assert_eq!(stream.failure(7000 * MS), None);
        assert!(stream.failure(8015 * MS).unwrap().contains("late"));
    }

    #[test]
    fn of_a_device_without_a_counter_lost_samples_are_counted_against_the_clock() {
        let mut stream = stream();
        stream.begin(false, 5000 * MS);
        for step in 0..200 {
            push(&mut stream, step * 10, 5010 + step * 10);
        }
        // 100 ms are lost: what comes after them is numbered on, and comes later.
        for step in 200..600 {
            push(&mut stream, step * 10, 5110 + step * 10);
        }
        assert!((6095..=6105).contains(&stream.next_sample), "{}", stream.next_sample);
    }

    #[test]
    fn a_jump_of_the_index_without_time_passing_is_a_loss_and_no_lateness() {
        let mut stream = stream();
        stream.begin(true, 5000 * MS);
        for step in 0..500 {
            push(&mut stream, step * 10, 5010 + step * 10);
        }
        for step in 500..1500 {
            let blocks = push(&mut stream, 3000 + step * 10, 5010 + step * 10);
            assert_eq!(blocks[0].0, 3000 + step * 10);
            assert_eq!(stream.lateness_ns, 0, "step {step}");
        }
        assert_eq!(stream.failure(5010 * MS + 14_990 * MS), None);
    }
}
