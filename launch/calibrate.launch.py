"""One simulated gyro, its calibration and its corrector, in one namespace.

ros2 launch gyro_calib calibrate.launch.py seed:=7
ros2 service call /gyro/gyro_calibration/self_calibrate std_srvs/srv/Trigger
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    default_parameters = PathJoinSubstitution([FindPackageShare("gyro_calib"), "config", "gyro_calib.yaml"])
    arguments = [
        DeclareLaunchArgument("namespace", default_value="gyro", description="Namespace of the gyro"),
        DeclareLaunchArgument("device", default_value="ring_15k", description="Packaged device, or path of a description"),
        DeclareLaunchArgument("seed", default_value="1", description="Draws a unit of the design; -1 takes the design itself"),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="Follow /clock, e.g. of a robot simulator"),
        DeclareLaunchArgument("params_file", default_value=default_parameters, description="Parameters of the nodes"),
    ]
    clock = {"use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)}
    unit = {
        "device": ParameterValue(LaunchConfiguration("device"), value_type=str),
        "seed": ParameterValue(LaunchConfiguration("seed"), value_type=int),
    }

    def node(name, executable, *parameters):
        return Node(
            package="gyro_calib",
            executable=executable,
            name=name,
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("params_file"), clock, *parameters],
            output="screen",
        )

    return LaunchDescription(
        [
            *arguments,
            node("gyro_sim", "gyro_sim_node", unit),
            node("gyro_calibration", "calibration_node"),
            node("imu_corrector", "imu_corrector_node"),
        ]
    )
