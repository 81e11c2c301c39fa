"""Writes kinematics.bin: flange poses and Jacobians of the xArm7 as Pinocchio computes them.

    pip install pin
    python kinematics.py > kinematics.bin

The model is built from the joint origins of the vendor's URDF. There are 1000 postures; their joint angles are
not stored but drawn, joint by joint, uniformly within the limits: lower + (upper - lower) * (n >> 11) / 2**53, with
n the next number of SplitMix64 (Steele, Lea and Flood, 2014) from seed 7. For each posture, little-endian:

    12 x f64  position in m, then the rotation matrix row by row
    42 x i32  Jacobian row by row in units of 1e-9 (m or 1): linear x y z, then angular x y z, at the flange, in
              the base frame
"""

import struct
import sys
from math import pi

import numpy as np
import pinocchio

JOINTS = [  # xyz in m, rpy in rad, lower and upper limit in rad
    ((0, 0, 0.267), (0, 0, 0), -2 * pi, 2 * pi),
    ((0, 0, 0), (-pi / 2, 0, 0), -2.059, 2.0944),
    ((0, -0.293, 0), (pi / 2, 0, 0), -2 * pi, 2 * pi),
    ((0.0525, 0, 0), (pi / 2, 0, 0), -0.19198, 3.927),
    ((0.0775, -0.3425, 0), (pi / 2, 0, 0), -2 * pi, 2 * pi),
    ((0, 0, 0), (pi / 2, 0, 0), -1.69297, pi),
    ((0.076, 0.097, 0), (-pi / 2, 0, 0), -2 * pi, 2 * pi),
]


def split_mix(state):
    """Uniform numbers in 0..1."""
    mask = 2**64 - 1
    while True:
        state = (state + 0x9E3779B97F4A7C15) & mask
        number = ((state ^ state >> 30) * 0xBF58476D1CE4E5B9) & mask
        number = ((number ^ number >> 27) * 0x94D049BB133111EB) & mask
        yield ((number ^ number >> 31) >> 11) / 2**53


def build_model():
    model = pinocchio.Model()
    parent = 0
    for number, (xyz, rpy, _, _) in enumerate(JOINTS, start=1):
        origin = pinocchio.SE3(pinocchio.rpy.rpyToMatrix(*rpy), np.array(xyz, float))
        parent = model.addJoint(parent, pinocchio.JointModelRZ(), origin, f"joint{number}")
    return model


def main():
    model = build_model()
    data = model.createData()
    random = split_mix(7)
    for _ in range(1000):
        joints = np.array([lower + (upper - lower) * next(random) for _, _, lower, upper in JOINTS])
        jacobian = pinocchio.computeJointJacobian(model, data, joints, 7)  # in the flange's own frame
        pinocchio.forwardKinematics(model, data, joints)
        flange = data.oMi[7]
        jacobian = np.vstack([flange.rotation @ jacobian[:3], flange.rotation @ jacobian[3:]])
        sys.stdout.buffer.write(struct.pack("<12d", *flange.translation, *flange.rotation.ravel()))
        sys.stdout.buffer.write(np.round(jacobian.ravel() * 1e9).astype("<i4").tobytes())


if __name__ == "__main__":
    main()
