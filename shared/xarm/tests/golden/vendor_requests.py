"""Makes vendor_requests.txt: the bytes that the vendor's own client sends for each command.

    pip install xarm-python-sdk==1.18.4
    python vendor_requests.py | grep -v SDK_VERSION > vendor_requests.txt
"""

import math

from xarm.core.wrapper.uxbus_cmd_tcp import UxbusCmdTcp


class Wire:
    """In place of the socket: keeps what is sent, and answers it with state 0 and zeros."""

    def __init__(self):
        self.sent = b""

    def flush(self):
        pass

    def write(self, data):
        self.sent = bytes(data)
        return 0

    def read(self, _timeout):
        return self.sent[:4] + bytes([0, 42]) + self.sent[6:7] + bytes(41)


def main():
    wire = Wire()
    arm = UxbusCmdTcp(wire)
    for name, send in [
        ("get_version", arm.get_version),
        ("get_serial_number", arm.get_robot_sn),
        ("enable", lambda: arm.motion_en(8, 1)),
        ("disable_3", lambda: arm.motion_en(3, 0)),
        ("run", lambda: arm.set_state(0)),
        ("pause", lambda: arm.set_state(3)),
        ("stop", lambda: arm.set_state(4)),
        ("slow_and_stop", lambda: arm.set_state(6)),
        ("get_state", arm.get_state),
        ("get_command_count", arm.get_cmdnum),
        ("get_errors", arm.get_err_code),
        ("clear_error", arm.clean_err),
        ("clear_warning", arm.clean_war),
        ("mode_5", lambda: arm.set_mode(5)),
        ("get_pose", arm.get_tcp_pose),
        ("get_joints", arm.get_joint_pos),
        ("reduced_speed", lambda: arm.set_reduced_linespeed(150)),
        ("reduced_mode", lambda: arm.set_reduced_mode(1)),
        ("boundary", lambda: arm.set_xyz_limits([700, -700, 600, -600, 500, -100])),
        ("fence", lambda: arm.set_fense_on(1)),
        ("joint_velocity", lambda: arm.vc_set_jointv([0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7], 1, 0.2)),
        ("flange_velocity", lambda: arm.vc_set_linev([30, 0, 20, math.pi / 6, 0, 0], 0, 0.2)),
        ("tool_velocity", lambda: arm.vc_set_linev([-1.5, 2, 0, 0, 0.25, 0], 1, -1)),
        ("gripper_enable", lambda: arm.gripper_modbus_set_en(1)),
        ("gripper_mode", lambda: arm.gripper_modbus_set_mode(0)),
        ("gripper_speed", lambda: arm.gripper_modbus_set_posspd(2000)),
        ("gripper_open", lambda: arm.gripper_modbus_set_pos(850)),
        ("gripper_closed", lambda: arm.gripper_modbus_set_pos(-10)),
        ("gripper_position", arm.gripper_modbus_get_pos),
        ("gripper_error", arm.gripper_modbus_get_errcode),
        ("gripper_off", lambda: arm.gripper_modbus_set_en(0)),
        ("gripper_status", lambda: arm.gripper_modbus_r16s(0x0000, 1)),
    ]:
        send()
        print(name, wire.sent.hex())


if __name__ == "__main__":
    main()
