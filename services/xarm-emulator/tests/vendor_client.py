"""The vendor's own client drives the emulator: connect, identify, enable, set mode and state, move, read, grip and
stop the grip, see errors and what is set on the controller.

    python vendor_client.py CONTROL_PORT NORMAL_PORT RICH_PORT REAL_TIME_PORT

Needs `pip install xarm-python-sdk==1.18.4`. The ports are those of an emulator on 127.0.0.1 with the properties that
`vendor_client.rs` gives it.
Faults are asked for by printing `inject FAULT`, which whoever runs this script passes on to the emulator. Waits for
conditions, for 10 s at most; exits with 1 where one does not come.
"""

import sys
import time

from xarm.core.config.x_config import XCONF

ports = [int(port) for port in sys.argv[1:5]]
(
    XCONF.SocketConf.TCP_CONTROL_PORT,
    XCONF.SocketConf.TCP_REPORT_NORM_PORT,
    XCONF.SocketConf.TCP_REPORT_RICH_PORT,
    XCONF.SocketConf.TCP_REPORT_REAL_PORT,
) = ports

from xarm.wrapper import XArmAPI  # noqa: E402  (the ports must be set before)
from xarm.x3.report import ReportDataStructure  # noqa: E402

# The client knows the layout of a report by the vendor's port.
layout_of = ReportDataStructure.create
vendor_port = dict(zip(ports[1:], (30001, 30002, 30003)))
ReportDataStructure.create = lambda port, **options: layout_of(vendor_port[port], **options)


def check(what, condition):
    """Says what was checked, and ends the script if it does not hold."""
    print(f"{'ok    ' if condition else 'FAILED'} {what}", flush=True)
    if not condition:
        sys.exit(1)


def wait_for(what, condition, seconds=10.0):
    """Waits until the condition holds."""
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    check(what, condition())


def bring_up(arm):
    """The vendor's order, and the pause after a change of mode or state that its documents ask for."""
    arm.clean_error()
    arm.clean_warn()
    check("motion_enable", arm.motion_enable(True) == 0)
    check("set_mode(5)", arm.set_mode(5) == 0)
    check("set_state(0)", arm.set_state(0) == 0)
    time.sleep(0.2)


for report_type in ("rich", "normal", "real"):
    arm = XArmAPI("127.0.0.1", is_radian=True, report_type=report_type)
    check(f"connected, {report_type} reports", arm.connected)
    wait_for("reports come", lambda: any(arm.angles))
    check("seven joints", arm.axis == 7)
    check(f"version (is {arm.version})", arm.version == "7,7,XI1305,AC1300,v2.5.0")
    check("version_number", arm.version_number == (2, 5, 0))
    check(f"get_robot_sn (is {arm.get_robot_sn()})", arm.get_robot_sn() == (0, "XI130506D01L04"))
    check("the xArm7", arm.device_type == 7)
    if report_type != "real":
        near = lambda found, wanted: all(abs(one - other) < 1e-3 for one, other in zip(found, wanted, strict=True))
        wait_for("the TCP offset", lambda: near(arm.tcp_offset, [1.0, -2.0, 172.0, 0.0, 0.0, 0.5]))
        check("the load", near([arm.tcp_load[0], *arm.tcp_load[1]], [0.82, 0.0, 1.0, 48.0]))
        check("the collision sensitivity", arm.collision_sensitivity == 4)
        check("the teaching sensitivity", arm.teach_sensitivity == 2)
        check("the direction of gravity", near(arm.gravity_direction, [0.0, 0.0, 1.0]))
    bring_up(arm)
    wait_for("mode 5, state ready, no error", lambda: arm.mode == 5 and arm.state in (1, 2) and arm.error_code == 0)

    code, start = arm.get_position()
    check("get_position", code == 0 and len(start) == 6)
    code, joints = arm.get_servo_angle()
    check("get_servo_angle", code == 0 and len(joints) == 7)
    check("vc_set_cartesian_velocity", arm.vc_set_cartesian_velocity([0, 20, 0, 0, 0, 0], duration=1.0) == 0)
    wait_for("the arm runs", lambda: arm.get_state()[1] == 1)
    wait_for("it comes to rest by itself", lambda: arm.get_state()[1] == 2)
    moved = arm.get_position()[1]
    way_mm = moved[1] - start[1]
    check(f"it went 20 mm along y (went {way_mm:.2f})", abs(way_mm - 20.0) < 1.0)
    check("and nowhere else", abs(moved[0] - start[0]) < 1.0 and abs(moved[2] - start[2]) < 1.0)
    wait_for("the reports say so, too", lambda: abs(arm.position[1] - moved[1]) < 0.1)
    check("the joints moved", arm.get_servo_angle()[1] != joints)
    arm.vc_set_cartesian_velocity([0, -50, 0, 0, 0, 0], duration=0.4)
    wait_for("back", lambda: abs(arm.get_position()[1][1] - start[1]) < 1.0)

    check("set_gripper_enable", arm.set_gripper_enable(True) == 0)
    check("set_gripper_mode", arm.set_gripper_mode(0) == 0)
    check("set_gripper_speed", arm.set_gripper_speed(2000) == 0)
    check("set_gripper_position(200), waiting", arm.set_gripper_position(200, wait=True, wait_motion=False) == 0)
    code, pulses = arm.get_gripper_position()
    check(f"get_gripper_position (is {pulses})", code == 0 and abs(pulses - 200) <= 1)
    check("set_gripper_position(850)", arm.set_gripper_position(850, wait=True, wait_motion=False) == 0)
    check("a slow gripper", arm.set_gripper_speed(100) == 0)
    check("it closes", arm.set_gripper_position(0, wait_motion=False) == 0)
    wait_for("it says that it moves", lambda: arm.get_gripper_status() == (0, 1))
    present = arm.get_gripper_position()[1]
    check("its present position as target stops it", arm.set_gripper_position(present, wait_motion=False) == 0)
    wait_for("it says that it stands", lambda: arm.get_gripper_status() == (0, 0))
    check("where it was", abs(arm.get_gripper_position()[1] - present) <= 1)
    check("its motor off", arm.set_gripper_enable(False) == 0)
    arm.set_gripper_position(0, wait_motion=False)
    time.sleep(0.3)
    check("it does not move then", abs(arm.get_gripper_position()[1] - present) <= 1)
    check("its motor on", arm.set_gripper_enable(True) == 0)

    print("inject collision", flush=True)
    wait_for("get_err_warn_code tells the collision", lambda: arm.get_err_warn_code()[1][0] == 31)
    if report_type != "real":
        wait_for("the reports tell it", lambda: arm.error_code == 31)
    check("motion is refused", arm.vc_set_cartesian_velocity([0, 50, 0, 0, 0, 0], duration=0.4) != 0)
    bring_up(arm)
    wait_for("cleared", lambda: arm.get_err_warn_code()[1] == [0, 0])
    check("motion is taken again", arm.vc_set_cartesian_velocity([0, 5, 0, 0, 0, 0], duration=0.1) == 0)

    print("inject emergency-stop", flush=True)
    wait_for("the emergency stop is told", lambda: arm.get_err_warn_code()[1][0] == 1)
    print("inject release", flush=True)
    wait_for("it can be cleared once released", lambda: (arm.clean_error(), arm.get_err_warn_code()[1][0])[1] == 0)
    bring_up(arm)
    check("set_state(4) stops", arm.set_state(4) == 0 and arm.get_state()[1] == 4)
    arm.disconnect()

print("all ok", flush=True)
