//! `tendon sources`: where samples can come from.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use serde::Serialize;
use tendon_config::{AcquisitionSettings, Config, Source};
use tendon_lsl::{Inlet, Lsl, StreamFacts};
use tendon_output::collect;

use crate::configuration::Base;
use crate::output::{checked, print, tell};
use crate::times::duration;
use crate::{Failure, checks};

/// How long a stream may take to describe its channels.
const ANSWER: Duration = Duration::from_secs(1);

/// Command line of `tendon sources`.
#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    base: Base,
    /// How long to listen for streams on the network.
    #[arg(long, value_name = "TIME", value_parser = duration, default_value = "2s")]
    wait: Duration,
    /// Also write the list to this file, as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// What there is.
#[derive(Debug, Serialize)]
struct Sources {
    /// The source of a session with this configuration.
    configured: &'static str,
    /// What that is, or why it cannot be used.
    configured_detail: String,
    /// NI's driver and its devices.
    nidaqmx: String,
    lsl: LslSources,
}

/// What there is on the Lab Streaming Layer.
#[derive(Debug, Serialize)]
struct LslSources {
    /// The library and its version, if there is one.
    library: Option<String>,
    version: Option<String>,
    /// Why there is none.
    problem: Option<String>,
    streams: Vec<StreamFacts>,
}

/// Lists where samples can come from.
pub fn list(options: &Options) -> Result<(), Failure> {
    let json = checked(options.json.as_deref())?;
    let config = options.base.configuration().map_err(Failure::input)?;
    let acquisition = &config.acquisition;
    tell(format_args!("listening for {}", humantime::format_duration(options.wait)));
    let sources = Sources {
        configured: acquisition.source.name(),
        configured_detail: detail(&config),
        nidaqmx: checks::nidaqmx(&acquisition.nidaqmx),
        lsl: lsl(acquisition, options.wait),
    };
    let written = collect(json.iter().map(|json| json.write_json(&sources))).map_err(Failure::running);
    written.and(print(text(&sources, &config)).map_err(Failure::running))
}

/// What a session with this configuration reads. Streams of LSL are listed anyway.
fn detail(config: &Config) -> String {
    match config.acquisition.source {
        Source::Lsl => format!("the stream with {}", config.acquisition.lsl.describe()),
        _ => checks::source(config).unwrap_or_else(|error| format!("cannot be used: {error:#}")),
    }
}

fn lsl(acquisition: &AcquisitionSettings, wait: Duration) -> LslSources {
    let opened = tendon_lsl::find_library(acquisition.lsl.library.as_deref())
        .and_then(|library| Ok((Lsl::load(&library)?, library)));
    match opened {
        Err(error) => {
            LslSources { library: None, version: None, problem: Some(error.to_string()), streams: Vec::new() }
        }
        Ok((lsl, library)) => {
            let mut streams: Vec<StreamFacts> = lsl
                .streams(wait)
                .iter()
                .map(|stream| {
                    // One that does not describe itself is listed with what it said.
                    let described = Inlet::new(lsl, stream).and_then(|inlet| inlet.describe(ANSWER));
                    described.map_or_else(|_| stream.facts.clone(), |described| described.facts.clone())
                })
                .collect();
            streams.sort_by(|one, other| (&one.name, &one.uid).cmp(&(&other.name, &other.uid)));
            LslSources {
                library: Some(library.display().to_string()),
                version: Some(lsl.version()),
                problem: None,
                streams,
            }
        }
    }
}

fn text(sources: &Sources, config: &Config) -> String {
    let acquisition = &config.acquisition;
    let Sources { configured, configured_detail, .. } = sources;
    let mut lines =
        vec![format!("sessions here take their samples from: {configured} ({configured_detail})")];
    let mut source = |name: &str, what: String| lines.push(format!("{name:<10}{what}"));
    source("simulate", "the simulated amplifier".to_owned());
    source("replay", "a recording: tendon run --replay PATH".to_owned());
    let program = acquisition.program.as_ref().map(|program| program.display().to_string());
    let device = program.unwrap_or_else(|| "no program: acquisition.program names one".to_owned());
    source(Source::Device.name(), device);
    source(Source::Nidaqmx.name(), sources.nidaqmx.clone());
    for network in [Source::Otb, Source::Delsys, Source::Stream] {
        let acquisition = AcquisitionSettings { source: network, program: None, ..acquisition.clone() };
        source(network.name(), detail(&Config { acquisition, ..config.clone() }));
    }
    let LslSources { library, version, problem, streams } = &sources.lsl;
    match (library, problem) {
        (Some(library), _) => {
            let version = version.as_deref().unwrap_or_default();
            source("lsl", format!("{library}, version {version}; streams: {}", streams.len()));
        }
        (None, problem) => source("lsl", problem.clone().unwrap_or_default()),
    }
    for stream in streams {
        lines.push(format!("  {stream}"));
        for (place, channel) in stream.channel_facts.iter().enumerate() {
            let parts = [&channel.label, &channel.content_type, &channel.unit];
            let known: Vec<&str> =
                parts.into_iter().map(String::as_str).filter(|part| !part.is_empty()).collect();
            lines.push(format!("    {place:>3}  {}", known.join(", ")));
        }
    }
    if streams.iter().any(|stream| stream.sample_rate_hz > 0.0) {
        lines.push(
            "read one: tendon run --set acquisition.source=lsl --set 'acquisition.lsl.name=NAME' --set \
             acquisition.lsl.type=TYPE --set acquisition.sample_rate_hz=RATE"
                .to_owned(),
        );
    }
    lines.join("\n")
}
