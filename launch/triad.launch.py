"""Three simulated gyros along x, y and z, each with its calibration in a namespace of its own, joined to one Imu.

Each feels its component of /true_rate (geometry_msgs/TwistStamped), e.g. of a robot simulator. Calibrate them one by one or at once:

ros2 launch gyro_calib triad.launch.py seed:=7
ros2 service call /gyro_x/gyro_calibration/self_calibrate std_srvs/srv/Trigger
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

AXES = ("x", "y", "z")


def generate_launch_description():
    default_parameters = PathJoinSubstitution([FindPackageShare("gyro_calib"), "config", "gyro_calib.yaml"])
    arguments = [
        DeclareLaunchArgument("device", default_value="ring_15k", description="Packaged device, or path of a description"),
        DeclareLaunchArgument("seed", default_value="1", description="Of the unit along x; y and z take the next two"),
        DeclareLaunchArgument("frame_id", default_value="imu_link", description="Frame of the joined Imu"),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="Follow /clock, e.g. of a robot simulator"),
        DeclareLaunchArgument("params_file", default_value=default_parameters, description="Parameters of the nodes"),
    ]
    clock = {"use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)}

    def node(name, executable, namespace, parameters, **options):
        return Node(
            package="gyro_calib",
            executable=executable,
            name=name,
            namespace=namespace,
            parameters=[LaunchConfiguration("params_file"), clock, parameters],
            output="screen",
            **options,
        )

    gyros = []
    for index, axis in enumerate(AXES):
        unit = {
            "device": ParameterValue(LaunchConfiguration("device"), value_type=str),
            "seed": ParameterValue(PythonExpression([LaunchConfiguration("seed"), f" + {index}"]), value_type=int),
            "gyro_axis": axis,
            "frame_id": f"gyro_{axis}",
        }
        namespace = f"gyro_{axis}"
        gyros.append(node("gyro_sim", "gyro_sim_node", namespace, unit, remappings=[("true_rate", "/true_rate")]))
        gyros.append(node("gyro_calibration", "calibration_node", namespace, {"frame_id": f"gyro_{axis}"}))
    joined = {"gyros": [f"gyro_{axis}" for axis in AXES], "axes": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]}
    # one entry a gyro: empty asks the gyro for its device, and looks for its record in the default place
    joined |= {"device_ids": [""] * 3, "record_urls": [""] * 3}
    frame = {"frame_id": ParameterValue(LaunchConfiguration("frame_id"), value_type=str)}
    return LaunchDescription([*arguments, *gyros, node("imu_corrector", "imu_corrector_node", "", joined | frame)])
