"""OpenSim's inverse kinematics on what poser writes: joint angles from orientations and from markers.

Makes motion.sto and motion.trc of a motion, and a model with its skeleton. OpenSim then finds joint angles,
once from each file. A model of your own (--model FILE.osim) is used with the orientations: its segments get
frames named femur_r_imu and so on, which is how OpenSim finds the columns.
Needs: pip install opensim
Run: python examples/opensim_ik.py [MOTION] [--model FILE.osim] [-o FOLDER]
"""

import argparse
from pathlib import Path

import numpy as np
import opensim

from mocap import formats
from mocap.formats import opensim as tables
from mocap.skeleton import JOINTS
from mocap.stances import pose_bones
from mocap.synthesis import motions

NAMES = [tables.BODIES.get(joint, joint) for joint in JOINTS]
# The model's zero is the pose in which OpenSim's segments have the ground's axes: arms hang.
ZERO = pose_bones(np.arange(len(JOINTS)), "n", 90.0)


def vector(v):
    """A vector of our axes in those of OpenSim."""
    return opensim.Vec3(*(float(x) for x in tables.C @ v))


def skeleton_model(skeleton):
    """A body for every joint, ball joints between them, and the markers of the .trc file."""
    model = opensim.Model()
    model.setName("poser")
    bodies = []
    for j, name in enumerate(NAMES):
        # Kinematics asks for no masses, but OpenSim wants some.
        body = opensim.Body(name, 1.0, opensim.Vec3(0), opensim.Inertia(0.01, 0.01, 0.01))
        model.addBody(body)
        bodies.append(body)
        p = skeleton.parents[j]
        if p < 0:
            model.addJoint(opensim.FreeJoint("root", model.getGround(), body))
            continue
        at, none = vector(ZERO[p] @ skeleton.offsets[j]), opensim.Vec3(0)
        joint = opensim.GimbalJoint(JOINTS[j], bodies[p], at, none, body, none, none)
        for k, axis in enumerate("xyz"):
            joint.upd_coordinates(k).setName(f"{JOINTS[j]}_r{axis}")
        model.addJoint(joint)
    names, joints, places = tables.seats(skeleton)
    centres = [(JOINTS[j], j, np.zeros(3)) for j in range(len(JOINTS))]
    for name, j, place in [*zip(names, joints, places, strict=True), *centres]:
        model.addMarker(opensim.Marker(name, bodies[j], vector(ZERO[j] @ place)))
    model.finalizeConnections()
    return model


def with_sensors(model):
    """The model with a frame for each column of the .sto file; joints that none tells of are held at zero."""
    for name in tables.BODIES.values():
        if model.getBodySet().contains(name):
            body = model.updBodySet().get(name)
            frame = opensim.PhysicalOffsetFrame(f"{name}_imu", body, opensim.Transform())
            body.addComponent(frame)
    for joint in (model.updJointSet().get(k) for k in range(model.getJointSet().getSize())):
        if joint.getName() in JOINTS and joint.getName() not in tables.BODIES:
            for k in range(joint.numCoordinates()):
                joint.upd_coordinates(k).set_locked(True)
    model.finalizeConnections()
    return model


def over_all(tool, table):
    """From the first row of a table to the last: else the tool ends after 2 s."""
    times = table.getIndependentColumn()
    tool.setStartTime(times[0])
    tool.setEndTime(times[-1])


def from_orientations(model, sto, folder):
    """Joint angles in a .mot file, by OpenSim's IMU inverse kinematics."""
    tool = opensim.IMUInverseKinematicsTool()
    tool.setModel(model)
    tool.setName("sto")
    tool.set_orientations_file(str(sto))
    # The file's world is z up, OpenSim's y up.
    tool.set_sensor_to_opensim_rotations(opensim.Vec3(-np.pi / 2, 0, 0))
    over_all(tool, opensim.TimeSeriesTableQuaternion(str(sto)))
    tool.setResultsDir(str(folder))
    tool.run(False)
    return folder / f"ik_{sto.stem}.mot"


def from_markers(model, trc, folder):
    """Joint angles in a .mot file, by OpenSim's marker-based inverse kinematics."""
    tool = opensim.InverseKinematicsTool()
    tool.setModel(model)
    tool.setMarkerDataFileName(str(trc))
    over_all(tool, opensim.TimeSeriesTableVec3(str(trc)))
    tool.setResultsDir(str(folder))
    found = folder / f"ik_{trc.stem}_markers.mot"
    tool.setOutputMotionFileName(str(found))
    tool.run()
    return found


def coordinates(path):
    """Each coordinate of a .mot file over time: angles in deg, places in m."""
    table = opensim.TimeSeriesTable(str(path))
    values = table.getMatrix().to_numpy()
    return {n: values[:, k] for k, n in enumerate(table.getColumnLabels())}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("motion", nargs="?", help="any motion that poser reads (default: a walk)")
    parser.add_argument("--model", help="an OpenSim model of your own")
    parser.add_argument("-o", "--output", type=Path, default=Path("opensim-ik"))
    args = parser.parse_args()
    args.output.mkdir(exist_ok=True)
    opensim.Logger.setLevelString("warn")
    opensim.Logger.removeFileSink()  # no opensim.log beside you
    motion = formats.read(args.motion).content if args.motion else motions.walk(3.0)
    sto, trc = args.output / "motion.sto", args.output / "motion.trc"
    tables.write_orientations(sto, motion)
    tables.write_markers(trc, motion)
    model = opensim.Model(args.model) if args.model else skeleton_model(motion.skeleton)
    found = [from_orientations(with_sensors(model.clone()), sto, args.output)]
    if not args.model:
        found.append(from_markers(model, trc, args.output))
    for path in found:
        print(path)
        for name, angle in coordinates(path).items():
            if "knee" in name and np.ptp(angle) > 5:
                print(f"  {name}: {angle.min():.0f} to {angle.max():.0f} deg")


if __name__ == "__main__":
    main()
