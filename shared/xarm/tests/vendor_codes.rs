//! The codes that are explained are those that the vendor's client knows; `golden/vendor_codes.py` listed them.

use std::collections::BTreeSet;

use tendon_xarm::{Fault, Source};

#[test]
fn the_vendors_codes_and_no_others_are_explained() {
    let vendors: BTreeSet<(&str, u8)> = include_str!("golden/vendor_codes.txt")
        .lines()
        .map(|line| {
            let mut words = line.split(' ');
            (words.next().unwrap(), words.next().unwrap().parse().unwrap())
        })
        .collect();
    assert_eq!(vendors.len(), 84);
    for (name, source) in [
        ("controller", Source::Controller),
        ("warning", Source::Warning),
        ("servo", Source::Servo),
        ("gripper", Source::Gripper),
    ] {
        // No list of the vendor has it.
        let unknown = Fault { source, code: 200 };
        for code in 1..=u8::MAX {
            let fault = Fault { source, code };
            assert_eq!(vendors.contains(&(name, code)), fault.words() != unknown.words(), "{fault}");
            assert!(fault.remedy().len() > 10, "{fault}");
        }
    }
}
