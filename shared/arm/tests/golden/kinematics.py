"""Writes kinematics.json: flange poses and Jacobians of the xArm7 as Pinocchio computes them.

    pip install pin
    python kinematics.py > kinematics.json

The model is built from the joint origins of the vendor's URDF. Each case holds `joints_rad` (7),
`position_m` (3), `rotation` (9, row by row) and `jacobian` (42, row by row: linear x y z in metres, then
angular x y z, at the flange, in the base frame).
"""

import json
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
    random = np.random.default_rng(7)
    lower = np.array([joint[2] for joint in JOINTS])
    upper = np.array([joint[3] for joint in JOINTS])
    cases = []
    for _ in range(60):
        joints = random.uniform(lower, upper)
        jacobian = pinocchio.computeJointJacobian(model, data, joints, 7)  # in the flange's own frame
        pinocchio.forwardKinematics(model, data, joints)
        flange = data.oMi[7]
        jacobian = np.vstack([flange.rotation @ jacobian[:3], flange.rotation @ jacobian[3:]])
        cases.append(
            {
                "joints_rad": joints.tolist(),
                "position_m": flange.translation.tolist(),
                "rotation": flange.rotation.ravel().tolist(),
                "jacobian": jacobian.ravel().tolist(),
            }
        )
    print("[\n" + ",\n".join(json.dumps(case) for case in cases) + "\n]")


if __name__ == "__main__":
    main()
