//! Whatever bytes come on the control connection, in whatever pieces, the decoder ends and never panics, and so
//! do the readers of its frames and the emulator that obeys them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_xarm::Command;
use tendon_xarm::frame::Decoder;
use tendon_xarm::identity::Identity;
use tendon_xarm::reply::{Reply, fault};
use tendon_xarm_emulator::{Model, Properties, answer};

fuzz_target!(|input: (u8, Vec<u8>)| {
    let (piece, stream) = input;
    let mut decoder = Decoder::new();
    let mut model = Model::new(Properties::default(), 0);
    let mut now_ns = 0;
    let mut reply = Vec::new();
    for mut piece in stream.chunks(usize::from(piece).max(1)) {
        while let Some(frame) = decoder.next_frame(&mut piece) {
            if let Ok(reply) = Reply::parse(&frame) {
                if let Ok(text) = reply.text() {
                    let _ = Identity::parse(text, text).map(|identity| (identity.check(), identity.joint_limits()));
                }
                let _ = (reply.arm_state(), fault(&reply), reply.command_count());
                let _ = (reply.floats::<6>(), reply.floats::<7>());
                let _ = (reply.gripper_position_pulses(), reply.gripper_moves(), reply.gripper_took_it());
            }
            let _ = Command::decode(frame.body);
            reply.clear();
            answer(&mut model, &frame, &mut reply);
            now_ns += 150_000_000;
            model.advance_to(now_ns);
        }
    }
});
