# SPDX-License-Identifier: Apache-2.0
"""The commands and their options; the module of a command runs it."""

import math
from argparse import SUPPRESS
from pathlib import Path

from scara_effmass.cli.options import (
    BAG,
    BAGS,
    CELL,
    COUNT,
    DIRECTION,
    FORCE,
    FORCE_FILES,
    IMPORT,
    JOINTS,
    JSON,
    LIMITS,
    LOGGING,
    MASS,
    NOT_NEGATIVE,
    NUMBER,
    PAGE,
    PAYLOAD,
    PORT,
    POSITIVE,
    REPEATED,
    ROBOT,
    TIME,
    TOPIC,
    Option,
    flag,
    number,
    output,
    params,
    plane,
)
from scara_effmass.iso15066 import MIN_EFFECTIVE_MASS
from scara_effmass.settings import ForceSourceKind, FreeParameters, LumpingPolicy
from scara_effmass.wire.topics import RECORDED


class Command:
    """Help and options of one command. Of a tuple of options exactly one is required."""

    def __init__(self, summary: str, epilog: str, *options: Option | tuple[Option, ...]) -> None:
        self.summary = summary
        self.epilog = epilog
        self.options = options


NODES = ("monitor", "daq", "validator", "speed_scaling", "sim", "visualization")
ROS_COMMANDS = {*NODES, "record", "replay", "foxglove", "dashboard", "watch"}
"""Commands that take ROS arguments."""
PROTOCOL = tuple(f"protocol {step}" for step in ("init", "fill", "report", "schema"))
MODULES = {"import": "import_force"} | dict.fromkeys(NODES, "nodes") | dict.fromkeys(PROTOCOL, "protocol")
"""Modules of the commands that have no module of their name."""
GROUPS = {"protocol": "write, fill in and render a measurement protocol of contact forces"}
"""Commands of two words, by the first one."""
ALIASES = {"bench": "sim"}
"""Former names of commands, still accepted."""

COMMANDS = {
    "demo": Command(
        "run all nodes on the simulated cell or on a recording, and write a report",
        """\
Without --bag: a simulated robot drives into simulated carts. The monitor, force and validator nodes watch it over DDS,
the recorder records it, and a report compares predicted with simulated forces. This takes about a minute.

With --bag: the recording is replayed to the monitor, the force node plays its force if it has any, the run is recorded,
and a report shows verdicts, speeds and masses over time.

All nodes run as separate processes in a ROS domain of their own on this machine.

examples:
  scara-effmass demo
  scara-effmass demo --bag bags/tour --rate 2 --duration 10 --out out/tour
  scara-effmass demo --bag recording.bag --robot arm.urdf --topic /arm/joint_states --out out/arm
""",
        Option("--bag", "recording to replay (default: run the simulated cell)", "BAG", Path),
        TOPIC,
        *CELL,
        params("monitor_node"),
        Option(
            "--rate",
            "replay speed; 0: as fast as the monitor answers (default: 1)",
            kind=NOT_NEGATIVE,
            default=1.0,
        ),
        Option(
            "--duration",
            "duration of the replay or simulation [s] (default: all)",
            "S",
            POSITIVE,
            default=math.inf,
        ),
        Option(
            "-o --output --out", "output folder (default: out/demo)", "DIR", Path, dest="out", default=Path("out/demo")
        ),
        *PAGE,
        FORCE,
        JSON,
    ),
    "monitor": Command(
        "run the live monitor node",
        """\
ROS arguments follow -- or --ros-args and take precedence over the options.

examples:
  scara-effmass monitor
  scara-effmass monitor --robot my_robot.urdf --model full --payload 2.5 --payload-com 0 0 0.1 --person-speed 1.6
  scara-effmass monitor --params my_cell.yaml -- -r joint_states:=/cell/joint_states -p timeout:=0.1
""",
        *CELL,
        params("monitor_node"),
        *LOGGING,
    ),
    "daq": Command(
        "run the force node: an NI-9230, a recording, or simulated force",
        """\
ROS arguments follow -- or --ros-args and override the options. Force is positive in compression. Force from CSV and
TDMS files and from wrench topics is converted to a bag first: see `scara-effmass import --help`.

examples:
  scara-effmass daq --sensitivity 2.31
  scara-effmass daq --source bag --path recording.mcap
  scara-effmass daq --source sim -- -p sim.impact_period:=1.0
""",
        Option(
            "--source",
            "force source (default: ni9230); bag: a recording, sim: simulated force",
            kind=lambda text: ALIASES.get(text, text),
            choices=[kind.value for kind in ForceSourceKind],
        ),
        Option("--path", "bag with ForceBlocks, for the source bag", "BAG", dest="bag.path"),
        Option("--topic", "topic of the ForceBlocks (default: the only one)", "TOPIC", dest="bag.topic"),
        Option(
            "--sensitivity",
            "from the sensor's certificate [mV/N] (default: 2.248)",
            "MV_PER_N",
            NUMBER,
            dest="sensor.sensitivity",
        ),
        params("daq_node"),
        *LOGGING,
    ),
    "validator": Command(
        "run the node that compares impacts with their predictions",
        """\
ROS arguments follow -- or --ros-args and override the options. To change the obstacle mass at run time, set the
parameter obstacle_mass; sim_node and replayed recordings publish it on run_info.

examples:
  scara-effmass validator --obstacle-mass 2.39
  scara-effmass validator --params my_cell.yaml -- -p stiffness_n_m:=2e6
""",
        Option("--obstacle-mass", "mass of the obstacle, m_H [kg]", "KG", NUMBER),
        params("validator_node"),
        *LOGGING,
    ),
    "speed_scaling": Command(
        "run the node that slows a trajectory controller down to the allowable speed",
        """\
The node publishes a factor from 0 to 1 on joint_trajectory_controller/speed_scaling_input (control_msgs/
SpeedScalingFactor): 0 without a valid verdict, down at once, up slowly. The joint trajectory controller has no time-out
and scales in position mode only: see docs/consuming.md. ROS arguments follow -- or --ros-args.

examples:
  scara-effmass speed_scaling
  scara-effmass speed_scaling -- -r joint_trajectory_controller/speed_scaling_input:=/arm/speed_scaling_input
  scara-effmass speed_scaling --params my_cell.yaml -- -p latency:=0.02
""",
        params("speed_scaling_node"),
        *LOGGING,
    ),
    "sim": Command(
        "run the robot of the simulated cell",
        """\
A simulated robot repeatedly hits simulated carts. The node publishes joint states at 1 kHz and, on run_info, the
cart in place. A force node with the same start publishes the force of the same impacts.

examples:
  scara-effmass sim --start 1800000000
  scara-effmass daq --source sim -- -p sim.scene:=cell -p sim.start:=1800000000.0
""",
        Option("--start", "ROS time of the start [s] (default: now)", "S", NUMBER),
        Option("--seed", "random seed of the noise (default: 0)", kind=int),
        flag("--clock", "publish /clock and wait for nodes that fall behind", default=None),
        *LOGGING,
    ),
    "dashboard": Command(
        "show the cell of a monitor on a web page",
        """\
The page shows the verdict, the robot in 3-D, speeds, masses, impacts, validation, diagnostics and a log of episodes. It
shows UNKNOWN when the monitor is silent or the page has lost this server. It loads nothing from elsewhere. Other
machines reach it with --host and need the token, which travels unencrypted: use it in the network of the cell only.
State the robot and its parameters as for the monitor; ROS arguments follow -- and state the namespace. NiceGUI is
required: pip install 'scara_effmass[dashboard]'.

examples:
  scara-effmass dashboard --open
  scara-effmass dashboard --robot my_robot.urdf --host 0.0.0.0 --port 8321 -- -r __ns:=/cell
""",
        Option("--host", "address to listen on (default: 127.0.0.1, this machine)", default="127.0.0.1"),
        Option("--port", "TCP port; 0: a free one (default: 8321)", "PORT", PORT, default=8321),
        Option("--token", "token that the page requires (default: generated unless --host is this machine)"),
        flag("--open", "open the page in a browser if there is a display"),
        ROBOT[0],
        *JOINTS,
        PAYLOAD[0],
        params("monitor_node"),
    ),
    "visualization": Command(
        "run the node that draws robot, masses and verdicts for RViz and Foxglove",
        """\
Publishes effective_mass_markers (visualization_msgs/MarkerArray) in the base frame. Give it the robot and the contact
points of the monitor.

examples:
  scara-effmass visualization
  scara-effmass visualization --robot my_robot.urdf -- -p rate:=10.0
""",
        *CELL,
        params("visualization_node"),
        *LOGGING,
    ),
    "watch": Command(
        "show verdict and speeds of a live cell, full screen",
        """\
The verdict in large letters, speed and allowable speed, reason and remedy, and all contact points. The verdict is
UNKNOWN as soon as the monitor is silent for longer than it promises. A clock at the top shows that the display is
alive. ROS arguments follow -- or --ros-args. Ctrl-C ends it.

examples:
  scara-effmass watch
  scara-effmass watch -- -r __ns:=/cell_2
""",
    ),
    "import": Command(
        "convert force from CSV, TDMS and wrench topics, or joint states from CSV, to a bag",
        """\
FILE is a CSV file (.csv, .tsv, .txt), a TDMS file, or a bag with a topic of WrenchStamped, Wrench or Float64. BAG is a
rosbag2 folder, or a file if it ends in .mcap; it holds ForceBlocks for `daq --source bag` and `validate`. The first
FILE is on the topic force, the next ones are on force/file1, force/file2 and so on. With --joints, FILE is a CSV file
with joint states for `assess`; examples/joint_csv has mapping files for UR's RTDE and for `ros2 topic echo --csv`.

examples:
  scara-effmass import load_cell.csv -o load_cell
  scara-effmass import run.csv --topic "Force (lbf)" --time-column "Time (ms)" --invert -o run.mcap
  scara-effmass import bridge.tdms --topic cell/ai0 --sensitivity 2.31 -o bridge
  scara-effmass import wrist.mcap --topic /ft_sensor/wrench --axis norm -o wrist_force
  scara-effmass import rtde.csv --joints examples/joint_csv/ur_rtde.yaml -o motion
""",
        Option("files", "CSV file, TDMS file or bag", "FILE", Path, nargs="+"),
        output("BAG", "bag to write"),
        Option("--topic", "topic, CSV column or TDMS channel of the force (default: the only one)"),
        *IMPORT,
        Option("--frame", "frame of the sensor (default: force_sensor)", dest="frame_id"),
        Option("--joints", "mapping of CSV columns to joints: import joint states", "FILE", Path),
        FORCE,
        JSON,
    ),
    "replay": Command(
        "replay a bag to the live nodes, with /clock",
        """\
The time of the recording is published on /clock: run the nodes with use_sim_time, or the monitor answers UNKNOWN to
old joint states. The replay starts when every node of the suite that runs on /clock, or subscribes to a replayed topic,
is active, has received the clock and has discovered the others. If that takes longer than --wait, it fails and names
the nodes that are not ready. ROS arguments follow --; in a namespace (-r __ns:=/left) the recorded topics are published
in it, but for /tf, /tf_static and /diagnostics.

examples:
  scara-effmass monitor -- -p use_sim_time:=true
  scara-effmass replay bags/tour
  scara-effmass replay bags/tour --start 10 --duration 5 --rate 0.5 --loop
  scara-effmass replay recording.bag --topic /wx200/joint_states --rate 0
""",
        Option("bag", "bag to replay", "BAG", Path),
        Option(
            "--rate", "speed relative to the recording; 0: as fast as a monitor answers", kind=NOT_NEGATIVE, default=1.0
        ),
        Option("--start", "start in the recording [s]", "S", NOT_NEGATIVE, default=0.0),
        Option("--duration", "recorded time to replay [s]", "S", POSITIVE, default=math.inf),
        flag("--loop", "repeat until interrupted"),
        Option("--topic", "topic to publish as /joint_states (default: every topic keeps its name)"),
        Option("--topics", "topics to replay (default: all but node outputs)", "TOPIC", nargs="+", default=()),
        Option(
            "--subscribers",
            "minimum number of subscribers of the joint states before the start (default: 1)",
            "N",
            COUNT,
            default=1,
        ),
        Option("--wait", "maximum wait for the nodes [s] (default: 30)", "S", NOT_NEGATIVE, default=30.0),
        JSON,
    ),
    "record": Command(
        "record live topics to a bag that survives a crash; repair a bag",
        f"""\
Default topics: {", ".join(RECORDED)}.
Recording ends on Ctrl-C or SIGTERM. All messages older than one second are on the disk and can be read; if the recorder
is killed, its last file has no index until record --repair adds one. ROS arguments follow --.

examples:
  scara-effmass record -o run1
  scara-effmass record -o run2 joint_states force /camera/info --max-size 500
  scara-effmass record -o all --all --duration 60 -- -p use_sim_time:=true
  scara-effmass record --repair run1
""",
        Option("topics", "topics to record (default: the topics of the suite)", "TOPIC", nargs="*"),
        (
            Option("-o --output", "output folder", "BAG", Path),
            Option("--repair", "complete a bag of a killed recorder: folder or MCAP file", "BAG", Path),
        ),
        flag("--all", "record all topics except hidden ones"),
        Option("--max-size", "start a new file at this size [MB]; 0: never", "MB", NOT_NEGATIVE, default=0.0),
        Option("--max-duration", "start a new file after this time [s]; 0: never", "S", NOT_NEGATIVE, default=0.0),
        Option("--duration", "duration of the recording [s]", "S", POSITIVE, default=math.inf),
        flag("--no-compression", "do not compress (default: zstd)"),
        FORCE,
        JSON,
    ),
    "foxglove": Command(
        "serve live topics to Foxglove over a WebSocket, without foxglove_bridge",
        """\
Needs the extra foxglove: pip install 'scara_effmass[foxglove]'. In Foxglove, open ws://localhost:8765 and import
config/foxglove_layout.json. Clients only read. There is no password: leave the host as it is, or use a tunnel.

examples:
  scara-effmass foxglove
  scara-effmass foxglove contact_state effective_mass_markers --port 9000 -- -r __ns:=/cell
""",
        Option("topics", "topics to serve (default: those that record records)", "TOPIC", nargs="*"),
        Option("--host", "address to listen on (default: 127.0.0.1)", "ADDRESS", default="127.0.0.1"),
        Option("--port", "port to listen on; 0: any free one (default: 8765)", "PORT", PORT, default=8765),
    ),
    "assess": Command(
        "assess every joint state of bags offline; write a table or a bag",
        """\
FILE must end in .parquet, .csv or .mcap. Each bag is assessed by a fresh monitor, whose clock is the log time of the
joint states. DIR gets report.html, summary.json, and a figure of each bag and contact point as PNG and SVG.

Exit status 1: one of several bags could not be assessed; the others were.

examples:
  scara-effmass assess bags/tour -o tour.parquet --report out/tour
  scara-effmass assess monday.mcap tuesday.mcap -o week.csv --robot my_robot.urdf --model full
  scara-effmass assess bags/tour -o tour.mcap --region hand_fingers --contact-area-m2 2e-4 --json
  scara-effmass assess bags/tour -o press.parquet --direction 0 0 -1
  scara-effmass assess old.bag -o old.csv --joint-map "left_*=*" --velocity from-positions --velocity-window 0.05
  scara-effmass assess positions.bag --velocity-bag velocities.bag -o joined.csv --time log
""",
        BAGS,
        output("FILE", ".parquet, .csv or .mcap"),
        Option("--report", "folder for figures, episodes and summary", "DIR", Path),
        TOPIC,
        *CELL,
        Option("--velocity-bag", "recording of the velocities, joined by log time", "BAG", Path),
        TIME,
        *DIRECTION,
        params("monitor_node"),
        *PAGE,
        FORCE,
        JSON,
    ),
    "advise": Command(
        "advise a speed factor for each segment of a recorded motion, so that no state is too fast",
        """\
The factors are at most 1. Without --segments every motion between two standstills is a segment; 0 makes every joint
state one. Between segments the factor changes no faster than the largest recorded accelerations allow. DIR receives
segments.csv, advice.json, advice.png, advice.svg, and advised.mcap: the same path with the advised timing, assessed
again until no state is too fast. It is generated; no robot moved so.

A segment with a moving state that is UNKNOWN, or at which no speed is allowed, gets no factor and is named; there is no
advised.mcap then. Exit status 1: there is such a segment.

examples:
  scara-effmass advise bags/tour -o out/advice
  scara-effmass advise run1 -o out/run1 --segments 20 --verdict ok --params cell.yaml
""",
        Option("bag", "recording of the motion", "BAG", Path),
        output("DIR", "folder for factors, figure and the advised motion"),
        Option(
            "--segments",
            "number of segments of equal time; 0: every joint state (default: the motions between standstills)",
            "N",
            number("a whole number from 0", lambda count: count >= 0, int),
        ),
        Option(
            "--verdict",
            "worst verdict of the advised motion: warn, or ok, below warn_ratio (default: warn)",
            choices=["warn", "ok"],
            default="warn",
        ),
        TOPIC,
        *CELL,
        params("monitor_node"),
        FORCE,
        JSON,
    ),
    "validate": Command(
        "compare measured impacts with their predictions offline; write a report",
        """\
Impacts are detected in the force blocks of a recording; without force blocks, recorded impacts or wrenches are used.
--force-from reads the force from a file beside the recording, whose clock may be another: its offset is estimated.
The obstacle mass is --obstacle-mass, else the run information of the recording, else obstacle_mass in section
validator of FILE. All recordings form one series. DIR receives report.html, report.json, and figures as PNG and SVG.

The first line says whether the robot's masses are accepted, not accepted, or not decidable by this series, which then
states what to measure next. The second line compares the forces with the limits of the body regions. The device that
was hit has a stiffness k (--stiffness-n-m, else fitted) and a mass (--obstacle-mass, or infinite with --fixed); a
region has those of the standard. As E = mu v²/2 = F²/(2 k) at a speed, F_region = F sqrt(mu_region k_region / (mu k)).
Exit status 1: not accepted, not decidable, or a force above a limit; the report is written anyway.

examples:
  scara-effmass validate device.mcap -o out/device --fixed --stiffness-n-m 75e3 --region hand_fingers
  scara-effmass validate bags/campaign -o out/validation
  scara-effmass validate monday.mcap -o out/monday --obstacle-mass 2.39 --model full
  scara-effmass validate arm.mcap --force-from load_cell.csv --invert -o out/arm --obstacle-mass 2.39
  scara-effmass validate bags/campaign -o out/validation --params cell.yaml --force --json
""",
        BAGS,
        output("DIR", "folder for the report"),
        TOPIC,
        *FORCE_FILES,
        Option("--obstacle-mass", "mass of the obstacle, or of the measuring device, in all recordings", "KG", NUMBER),
        flag("--fixed", "the obstacle, or measuring device, cannot move", dest="obstacle_fixed", default=None),
        Option("--stiffness-n-m", "of the contact, or of the device (default: fitted to the series)", "N_M", NUMBER),
        *ROBOT,
        *PAYLOAD,
        *JOINTS,
        TIME,
        *LIMITS,
        params("monitor_node, validator_node and daq_node (its detection)"),
        *PAGE,
        FORCE,
        JSON,
    ),
    "protocol init": Command(
        "write an empty measurement protocol, or one with proposed test points",
        """\
FILE is a commented YAML file with everything that a measurement by ISO/PAS 5672 and RIA TR R15.806 states. --from and
--map propose test points: for each body region the contacts with the largest predicted force over its limit, in poses
that differ. A contact of --from has its recorded speed, one of --map the speed at which the force reaches the limit.

examples:
  scara-effmass protocol init
  scara-effmass protocol init --from bags/tour --region hand_fingers --region chest --points 2 -o tour.yaml
  scara-effmass protocol init --map --robot ur5.urdf --contact quasi_static -o ur5.yaml
""",
        Option("-o --output", "file to write (default: protocol.yaml)", "FILE", Path, default=Path("protocol.yaml")),
        Option("--from", "recording to propose test points from", "BAG", Path, dest="recording"),
        flag("--map", "propose test points from the workspace of the robot"),
        Option("--points", "test points of each body region (default: 3)", "N", COUNT, default=3),
        Option("--samples", "configurations of --map along each base axis (default: 2000)", "N", COUNT, default=2000),
        TOPIC,
        *CELL,
        params("monitor_node"),
        FORCE,
        JSON,
    ),
    "protocol fill": Command(
        "enter recorded contacts into a measurement protocol, and evaluate it",
        """\
The contacts in the recordings replace the repetitions of test ID: time, reached speed, largest force within and beyond
0.5 s, predicted mass and force, and the hash of the recording. Without BAG, only hashes and evaluations are computed,
as for a protocol that was filled in by hand. Comments of FILE are written anew. Exit status 1: a verdict is not OK.

examples:
  scara-effmass protocol fill protocol.yaml
  scara-effmass protocol fill protocol.yaml run1 run2 run3 --test hand_fingers_1
  scara-effmass protocol fill protocol.yaml arm.mcap --test chest_1 --force-from device.csv --robot ur5.urdf
""",
        Option("protocol", "measurement protocol", "FILE", Path),
        Option("bags", "recording, or folder of recordings", "BAG", Path, nargs="*"),
        Option("--test", "test point to which the recordings belong (default: the only one)", "ID"),
        Option("-o --output", "file to write (default: FILE itself)", "FILE", Path),
        TOPIC,
        *FORCE_FILES,
        *ROBOT,
        *PAYLOAD,
        *JOINTS,
        TIME,
        params("monitor_node, validator_node and daq_node (its detection)"),
        flag("--force", "replace existing output, and contacts that were filled in before"),
        JSON,
    ),
    "protocol report": Command(
        "render a measurement protocol as a page, and as PDF",
        """\
DIR receives report.html, which prints on A4, and report.json. The verdict is computed again; it is UNKNOWN where raw
data is missing or changed. Exit status 1: the verdict is not OK.

examples:
  scara-effmass protocol report protocol.yaml -o out/protocol
  scara-effmass protocol report protocol.yaml -o out/protocol --pdf --language de --force
""",
        Option("protocol", "measurement protocol", "FILE", Path),
        output("DIR", "folder for the report"),
        *PAGE,
        FORCE,
        JSON,
    ),
    "protocol schema": Command(
        "print the JSON schema of a measurement protocol, for editors",
        """\
examples:
  scara-effmass protocol schema > protocol.schema.json
""",
    ),
    "figures": Command(
        "draw the figures of the paper again and compare its numbers",
        """\
DIR receives every figure as PNG and SVG, and the paper's claims beside this project's results in index.html and
claims.json. The robot is the shipped Omron i4-550L. Forces are those of the shipped campaign, which is simulated,
or of --campaign. A claim that does not match is not an error.

With --robot: Figs. 6, 8 to 12 and 15 for another robot, from 20 000 configurations over its joint ranges; the page says
what is left out, and why.

examples:
  scara-effmass figures -o out/figures
  scara-effmass figures -o out/ur5 --robot ur5.urdf
  scara-effmass figures -o out/figures --campaign out/campaign --force --json
""",
        output("DIR", "folder for figures and page"),
        Option("--campaign", "recorded impacts, one bag per run (default: the shipped ones)", "DIR", Path),
        Option("--robot", "another robot, URDF or DH YAML, without claims and experiment", "FILE"),
        params("monitor_node, for --robot"),
        FORCE,
        JSON,
    ),
    "campaign": Command(
        "simulate the impact experiment of the paper and record it to bags",
        """\
Robot, cart and force sensor are simulated (MuJoCo); nothing is measured, and every bag says so. DIR receives one bag
per run with joint states, force and run information, as the nodes would record them. Existing bags of the same run
are kept, so an interrupted campaign can be resumed.

examples:
  scara-effmass campaign -o out/campaign
  scara-effmass campaign -o out/light --configuration 300_200 --mass 0.5 --mass 2.39 --repetitions 1
  scara-effmass campaign -o out/hertz --hertz --tip-stiffness 1e8 --seed 1 --json
""",
        output("DIR", "folder for the bags"),
        Option(
            "--repetitions",
            "runs of each case (default: 3)",
            "N",
            COUNT,
            default=3,
        ),
        Option(
            "--seed",
            "random seed of variations and noise",
            kind=number("a whole number from 0", lambda seed: seed >= 0, int),
        ),
        Option("--configuration", f"impact point, as 300_200 for (300, 200) mm; {REPEATED}", "NAME", action="append"),
        Option("--mass", f"mass of the cart; {REPEATED}", "KG", MASS, action="append"),
        Option(
            "--tip-stiffness",
            "of the tip [N/m] (default: 2e6), with --hertz [N/m^1.5] (default: 1.075e8)",
            "K",
            NUMBER,
        ),
        Option("--stiffness", SUPPRESS, kind=NUMBER),  # former, in N/mm
        Option("--damping", "of the tip (default: 0)", "N_S_PER_M", NUMBER, default=0.0),
        Option("--friction", "between tip and plate (default: 0)", "COEFFICIENT", NUMBER, default=0.0),
        flag("--hertz", "use a Hertz contact, F = k d^1.5, not a linear spring"),
        FORCE,
        JSON,
    ),
    "evidence": Command(
        "simulate random impacts at the allowed speed: is the limit kept?",
        """\
A SCARA, two arms with six axes and one with seven hit a free plate with random motions, regions and plate normals, with
joints free and on a servo, each at exactly the speed that the monitor allows (MuJoCo); nothing is measured. DIR gets
impacts.csv, with a row for each impact and setting, report.html, summary.json, and a figure as PNG and SVG. Existing
impacts of the same seed and version are kept, so an interrupted run can be resumed. 10 000 impacts take about half an
hour on two cores.

examples:
  scara-effmass evidence -o out/evidence
  scara-effmass evidence -o out/short --impacts 200 --seed 7 --json
""",
        output("DIR", "folder for table and report"),
        Option(
            "--impacts",
            "number of impacts (default: 10000)",
            "N",
            number("a whole number from 1", lambda count: count >= 1, int),
            default=10_000,
        ),
        Option(
            "--seed",
            "random seed (default: 1)",
            kind=number("a whole number from 0", lambda seed: seed >= 0, int),
            default=1,
        ),
        Option(
            "--jobs",
            "number of processes (default: one per core)",
            "J",
            number("a whole number from 1", lambda jobs: jobs >= 1, int),
        ),
        FORCE,
        JSON,
    ),
    "map": Command(
        "map masses and allowable speeds over the workspace of a robot",
        """\
The map shows the effective mass along n (--direction), the reduced masses along n and along the worst contact normal,
and the allowable speed of a motion along n, of the first contact point, as the monitor computes them. The
configurations are spread evenly over the joint ranges; each cell shows the worst of those that reach it. One between
them may be worse; the last line tells how much more --samples may change. DIR receives map.png, map.svg, map.json,
and a table with a row for each cell and its slowest configuration.

examples:
  scara-effmass map -o out/map
  scara-effmass map ur5.urdf -o out/ur5 --model full --plane z=0.3 --direction 0 0 -1
  scara-effmass map panda.urdf -o out/panda --model full --plane y=0 --region hand_fingers --table parquet
""",
        Option("robot", "URDF or DH YAML (default: the shipped Omron i4-550L)", "ROBOT", nargs="?"),
        output("DIR", "folder for figure, table and summary"),
        *DIRECTION,
        Option(
            "--plane",
            "plane of the base, as z=0.3 [m] (default: the whole workspace, seen from above)",
            "AXIS=M",
            plane,
            default=(2, math.nan),
        ),
        Option(
            "--samples",
            "number of configurations (default: 20000)",
            "N",
            number("a whole number from 100", lambda count: count >= 100, int),
            default=20_000,
        ),
        Option("--table", "format of the table (default: csv)", choices=["csv", "parquet"], default="csv"),
        *CELL[1:],
        params("monitor_node"),
        FORCE,
        JSON,
    ),
    "coverage": Command(
        "show which joint positions, directions and speeds recordings cover",
        """\
BAG is a recording, a folder of recordings, or the coverage.json of an earlier run with this robot, whose counts are
added. DIR receives coverage.json, coverage.png and coverage.svg. Joint states that the monitor refuses do not count.
The poses are the combinations of four bins of each joint.

examples:
  scara-effmass coverage bags/tour bags/campaign -o out/coverage
  scara-effmass coverage tuesday.mcap out/coverage/coverage.json -o out/both
""",
        BAGS,
        output("DIR", "folder for figure and counts"),
        TOPIC,
        *ROBOT,
        *JOINTS,
        TIME,
        params("monitor_node"),
        FORCE,
        JSON,
    ),
    "init": Command(
        "write a commented parameter file of a cell, which every node and command takes",
        """\
Options set its parameters; on a terminal, init asks for those that are missing. FILE states all of them with their
meaning, is one that `doctor --params FILE` accepts, and serves monitor, validator and daq. With --bag, the joint states
of the recording are assessed with it, and the summary printed. Exit status 1: all of them are UNKNOWN.

examples:
  scara-effmass init
  scara-effmass init --robot ur5.urdf --bag run1 --payload 2.5 --payload-com 0 0 0.1 --region hand_fingers -o cell.yaml
  scara-effmass init --robot ur5.urdf --contact-point tool0 --contact-point "elbow=upper_arm_link: 0 0 0.4"
""",
        ROBOT[0],
        BAG,
        TOPIC,
        *CELL[1:],
        Option("-o --output", "file to write (default: cell.yaml)", "FILE", Path, default=Path("cell.yaml")),
        FORCE,
    ),
    "lump": Command(
        "show the lumped model of a robot and compare it with the full model",
        """\
Prints the two masses of each link as in Table II of the paper, why a link has none and what --policy did about it,
the masses by axis, and lumped over full masses at random poses along random directions: effective masses, and
reduced masses with a hand and with a chest. DIR receives lump.json and a picture of the masses on the robot.
Exit status 1: there is no lumped model.

examples:
  scara-effmass lump
  scara-effmass lump panda.urdf --policy project_com --free-parameters fit_inertia -o out/panda
  scara-effmass lump arm.urdf --poses 10000 --seed 2 --json
""",
        Option("robot", "URDF or DH YAML (default: the shipped Omron i4-550L)", "ROBOT", nargs="?"),
        Option("-o --output", "folder for picture and lump.json", "DIR", Path),
        Option(
            "--policy",
            "answer to links without two masses on their axes (default: refuse)",
            choices=[policy.value for policy in LumpingPolicy],
        ),
        Option(
            "--free-parameters",
            "choice among several pairs of masses (default: minimum_spread)",
            choices=[rule.value for rule in FreeParameters],
        ),
        Option("--poses", "number of random poses (default: 2000)", "N", COUNT, default=2000),
        Option(
            "--seed",
            "random seed of poses and directions (default: 1)",
            kind=number("a whole number from 0", lambda seed: seed >= 0, int),
            default=1,
        ),
        params("monitor_node"),
        FORCE,
        JSON,
    ),
    "limits": Command(
        "print the body-region limits and the allowable speeds",
        """\
Speeds are relative speeds at nominal values; the monitor adds its uncertainty margins.

examples:
  scara-effmass limits
  scara-effmass limits --mass 0.97 --mass 2.77 --region hand_fingers --region chest
  scara-effmass limits --mass 2.77 --contact quasi_static --json
""",
        Option(
            "--mass",
            "effective mass to compute allowable speeds for; may be repeated",
            "KG",
            number(f"a number >= {MIN_EFFECTIVE_MASS:g} kg", lambda mass: MIN_EFFECTIVE_MASS <= mass < math.inf),
            dest="masses",
            action="append",
            default=[],
        ),
        *LIMITS,
        params("monitor_node"),
        JSON,
    ),
    "completion": Command(
        "print the script that completes commands, options and files in a shell",
        """\
examples:
  scara-effmass completion bash > ~/.local/share/bash-completion/completions/scara-effmass
  scara-effmass completion fish > ~/.config/fish/completions/scara-effmass.fish
""",
        Option("shell", "bash, zsh or fish", choices=["bash", "zsh", "fish"]),
    ),
    "doctor": Command(
        "check the installation, the DAQ device and a robot model",
        """\
Exit code 0: a monitor can run with this robot; 1: something that it needs is wrong.

examples:
  scara-effmass doctor
  scara-effmass doctor --robot my_robot.urdf --model full --contact-point "elbow=upper_arm_link: 0 0 0.4"
  scara-effmass doctor --json
""",
        *CELL,
        params("monitor_node and daq_node"),
        JSON,
    ),
}
"""Commands by name."""
