# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass identify`."""

import argparse

from scara_effmass.analysis.identification import HEADINGS, identify
from scara_effmass.analysis.output import check_output_files, check_output_path
from scara_effmass.cli.console import print_result, print_table
from scara_effmass.cli.options import monitor_settings, require_no_payload_topic, robot_line
from scara_effmass.errors import RobotError
from scara_effmass.identification.corrected_robot import corrected_name, corrected_robot

NAME, RESULT = "identification", "identify.json"


def run(args: argparse.Namespace) -> int:
    """Print the masses of the robot by a recording; return 1 if its torques do not fit the model."""
    settings = monitor_settings(args)
    require_no_payload_topic(settings, "identification")
    corrected = corrected_name(settings.robot_path)
    if args.output:
        from scara_effmass.analysis import report  # noqa: PLC0415 - matplotlib, an extra
        from scara_effmass.analysis.robot_figures import draw_identification  # noqa: PLC0415

        check_output_files(args.output, [*report.figure_files([NAME]), RESULT], overwrite=args.force)
        check_output_path(args.output / corrected, overwrite=args.force, mark=b"identified by scara-effmass")
    found = identify(args.bag, settings, args.topic)
    result, lines = found.as_dict(), [robot_line(found.robot, settings), *found.lines()]
    is_fit = not found.estimate.unfit
    if args.output:
        files: dict[str, dict[str, object] | bytes] = {RESULT: result}
        problem = "the torques do not fit"
        if is_fit:
            try:
                files[corrected] = corrected_robot(found.estimate, settings, args.bag, found.mass_uncertainties[1])
            except RobotError as error:
                problem = str(error)
        figure = report.report_figure(NAME, "Identified masses", found.robot.name, draw_identification(found))
        report.write_report_files(args.output, files, [figure], overwrite=args.force, former=[corrected])
        written = [*files, *report.figure_files([NAME])]
        lines.append(("written", ", ".join(str(args.output / name) for name in written)))
        if corrected not in files:
            lines.append(("no robot file", problem))
    print_result(result, lines, as_json=args.json)
    if is_fit and not args.json:
        print_table("Masses of the links, friction and torques", HEADINGS, found.rows())
    return 0 if is_fit else 1
