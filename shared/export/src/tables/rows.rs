//! The rows of the tables, message by message.

use std::fs::File;
use std::io::{self, BufWriter};

use tendon_messages::{Activity, ArmPhase, Hindrance, Permission, Stage, StopReason, TWIST_LENGTH};
use tendon_session_file::{Block, CommandRecord, Cue, Event, PredictionRecord, StateRecord, TraceRecord};
use tendon_zones::TaskReport;

use super::columns::{Columns, names};
use crate::chronicle::{Chronicle, Happening, Taken, Trial};
use crate::staging::Staging;
use crate::table::Table;
use crate::{ExportError, Survey};

type FileTable = Table<BufWriter<File>>;

/// All tables, as far as they are written.
pub(super) struct Rows<'a> {
    survey: &'a Survey,
    chronicle: Chronicle,
    signal: FileTable,
    predictions: FileTable,
    decisions: FileTable,
    commands: FileTable,
    arm: FileTable,
    events: FileTable,
    trials: FileTable,
}

impl<'a> Rows<'a> {
    pub(super) fn begin(
        survey: &'a Survey,
        columns: &Columns,
        staging: &mut Staging,
    ) -> Result<Rows<'a>, ExportError> {
        let mut table = |file: &str, columns: &[super::columns::Column]| {
            let output = staging.create(file)?;
            Table::begin(output, names(columns)).map_err(ExportError::writing(file.as_ref()))
        };
        Ok(Rows {
            survey,
            chronicle: Chronicle::new(survey),
            signal: table("signal.csv", &columns.signal)?,
            predictions: table("predictions.csv", &columns.predictions)?,
            decisions: table("decisions.csv", &columns.decisions)?,
            commands: table("commands.csv", &columns.commands)?,
            arm: table("arm.csv", &columns.arm)?,
            events: table("events.csv", &columns.events)?,
            trials: table("trials.csv", &columns.trials)?,
        })
    }

    pub(super) fn block(&mut self, block: &Block) -> io::Result<()> {
        let Taken { placed, cue, ended } = self.chronicle.block(block);
        cue.iter().try_for_each(|cue| self.happening(cue))?;
        ended.iter().try_for_each(|trial| self.trial(trial))?;
        let samples = block.samples as usize;
        for sample in 0..samples {
            self.signal.seconds(placed.start_s + sample as f64 / self.survey.sample_rate_hz)?;
            for channel in block.values.chunks_exact(samples) {
                self.signal.number(channel[sample])?;
            }
            self.signal.end_row()?;
        }
        Ok(())
    }

    pub(super) fn prediction(&mut self, prediction: &PredictionRecord) -> io::Result<()> {
        let PredictionRecord { trace, context, novelty, probabilities, efforts } = prediction;
        let time_s = self.survey.window_end_s(&self.chronicle.timeline, trace, context);
        let most_probable = probabilities.iter().enumerate().max_by(|(_, a), (_, b)| a.0.total_cmp(&b.0));
        let table = &mut self.predictions;
        table.seconds(time_s)?;
        table.cell(context.first_sample)?;
        table.cell(context.truth.map_or("", |truth| self.survey.gesture(truth)))?;
        table.cell(match Activity::from_number(context.activity) {
            Activity::Calibrating => "calibrating",
            Activity::Rest => "rest",
            Activity::Move => "move",
        })?;
        table.cell(context.replaced_samples)?;
        table.number(novelty.0)?;
        table.cell(most_probable.map_or("", |(number, _)| self.survey.gesture(number as u8)))?;
        table.numbers(probabilities, self.survey.gestures.len())?;
        table.numbers(efforts, self.survey.gestures.len())?;
        for stage in [Stage::Dsp, Stage::Inference] {
            table.optional(transit_us(trace, stage))?;
            table.optional(work_us(trace, stage))?;
        }
        table.optional(age_us(trace, Stage::Inference))?;
        table.end_row()
    }

    pub(super) fn command(&mut self, command: &CommandRecord) -> io::Result<()> {
        let CommandRecord { trace, context, .. } = command;
        let time_s = self.survey.window_end_s(&self.chronicle.timeline, trace, context);
        let table = &mut self.decisions;
        table.seconds(time_s)?;
        table.cell(context.first_sample)?;
        table.cell(self.survey.gesture(command.gesture))?;
        table.number(command.confidence.0)?;
        table.cell(self.survey.gesture(command.voted))?;
        table.cell(command.is_unsure)?;
        table.cell(command.mode)?;
        table.optional(transit_us(trace, Stage::Decision))?;
        table.optional(work_us(trace, Stage::Decision))?;
        table.optional(age_us(trace, Stage::Decision))?;
        table.end_row()?;
        let table = &mut self.commands;
        table.seconds(time_s)?;
        table.cell(context.first_sample)?;
        table.cell(if command.frame == 0 { "base" } else { "tool" })?;
        table.numbers(&command.twist, TWIST_LENGTH)?;
        table.cell(command.gripper_toggles)?;
        table.end_row()
    }

    pub(super) fn state(&mut self, state: &StateRecord) -> io::Result<()> {
        let time_s = self.chronicle.state_s(state);
        let changed = self.chronicle.state(state);
        let table = &mut self.arm;
        table.seconds(time_s)?;
        table.cell(match Permission::from_number(state.permission) {
            Permission::Granted => "granted",
            Permission::AwaitRest => "await_rest",
            Permission::Stopped => "stopped",
        })?;
        table.optional(StopReason::from_number(state.stop_reason))?;
        table.cell(match ArmPhase::from_number(state.arm_phase) {
            ArmPhase::Connecting => "connecting",
            ArmPhase::BringingUp => "bringing_up",
            ArmPhase::GoingToStart => "going_to_start",
            ArmPhase::Following => "following",
            ArmPhase::Waiting => "waiting",
        })?;
        table.cell(state.fault_code)?;
        table.optional(Hindrance::from_number(state.hindrance))?;
        table.cell(self.survey.gesture(state.gesture))?;
        table.cell(state.mode)?;
        table.numbers(&state.joints_rad, 7)?;
        table.numbers(&state.position_mm, 3)?;
        table.numbers(&state.orientation_rad, 3)?;
        table.number(state.speed_mm_per_s.0)?;
        table.number(state.gripper_position.0)?;
        table.number(state.start_distance_mm.0)?;
        table.end_row()?;
        changed.iter().try_for_each(|changed| self.happening(changed))
    }

    pub(super) fn event(&mut self, event: &Event) -> io::Result<()> {
        let happening = self.chronicle.event(event);
        self.happening(&happening)
    }

    pub(super) fn cue(&mut self, cue: &Cue) {
        self.chronicle.cue(cue);
    }

    pub(super) fn finish(mut self) -> io::Result<()> {
        let ended = self.chronicle.finish();
        ended.iter().try_for_each(|trial| self.trial(trial))?;
        let tables = [
            self.signal,
            self.predictions,
            self.decisions,
            self.commands,
            self.arm,
            self.events,
            self.trials,
        ];
        tables.into_iter().try_for_each(Table::finish)
    }

    fn trial(&mut self, trial: &Trial) -> io::Result<()> {
        self.trials.seconds(trial.start_s)?;
        self.trials.seconds(trial.end_s)?;
        self.trials.cell(&trial.gesture)?;
        self.trials.cell(trial.start_row)?;
        self.trials.cell(trial.end_row)?;
        self.trials.end_row()
    }

    fn happening(&mut self, happening: &Happening) -> io::Result<()> {
        self.events.seconds(happening.at_s)?;
        self.events.cell(happening.kind)?;
        self.events.cell(&happening.text)?;
        self.events.end_row()
    }
}

/// Writes the zones of a task.
pub(super) fn zones(task: &TaskReport, columns: &Columns, output: BufWriter<File>) -> io::Result<()> {
    let mut table = Table::begin(output, names(&columns.zones))?;
    for (zone, number) in task.zones.iter().zip(1_u32..) {
        table.cell(number)?;
        zone.centre_mm.iter().try_for_each(|centre_mm| table.cell(centre_mm))?;
        table.cell(zone.distance_mm)?;
        table.cell(zone.index_of_difficulty_bits)?;
        table.cell(u8::from(zone.reached))?;
        table.optional(zone.completion_time_s)?;
        table.optional(zone.movement_time_s)?;
        table.optional(zone.throughput_bits_per_s)?;
        table.cell(zone.path_length_mm)?;
        table.optional(zone.path_efficiency)?;
        table.cell(zone.overshoots)?;
        table.end_row()?;
    }
    table.finish()
}

/// From publishing by the stage before to receiving by `stage`, us.
fn transit_us(trace: &TraceRecord, stage: Stage) -> Option<f64> {
    let before = stage.index().checked_sub(1)?;
    between_us(trace.published_ns[before], trace.received_ns[stage.index()])
}

/// From receiving to publishing by `stage`, us.
fn work_us(trace: &TraceRecord, stage: Stage) -> Option<f64> {
    between_us(trace.received_ns[stage.index()], trace.published_ns[stage.index()])
}

/// From the capture of the newest sample to publishing by `stage`, us.
fn age_us(trace: &TraceRecord, stage: Stage) -> Option<f64> {
    between_us(trace.captured_ns, trace.published_ns[stage.index()])
}

/// `None` where a stage was not reached.
fn between_us(from_ns: u64, to_ns: u64) -> Option<f64> {
    let is_known = from_ns > 0 && to_ns >= from_ns;
    is_known.then(|| (to_ns - from_ns) as f64 / 1e3)
}
