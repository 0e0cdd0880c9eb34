// Moves an arm back to its start and tells when it is there.   usage: move PSM1
#include <cmath>
#include <iostream>
#include <ros/ros.h>
#include <sensor_msgs/JointState.h>

int main(int argc, char **argv) {
  ros::init(argc, argv, "mover", ros::init_options::AnonymousName);
  ros::NodeHandle node(argc > 1 ? argv[1] : "PSM1");
  const std::vector<double> goal = {0.0, 0.0, 0.12, 0.0, 0.0, 0.0};
  sensor_msgs::JointState measured;
  boost::function<void(const sensor_msgs::JointState &)> keep =
      [&](const sensor_msgs::JointState &message) { measured = message; };
  ros::Subscriber in = node.subscribe<sensor_msgs::JointState>(
      "measured_js", 1, keep, ros::VoidPtr(), ros::TransportHints().tcpNoDelay());
  ros::Publisher out = node.advertise<sensor_msgs::JointState>("move_jp", 1);

  sensor_msgs::JointState command;
  command.position = goal;
  bool sent = false;
  for (ros::Time end = ros::Time::now() + ros::Duration(40.0); ros::ok() && ros::Time::now() < end;
       ros::WallDuration(0.005).sleep()) {
    ros::spinOnce();
    if (!sent && out.getNumSubscribers() > 0 && in.getNumPublishers() > 0) {
      out.publish(command);
      sent = true;
    }
    double worst = measured.position.size() == goal.size() ? 0.0 : 1.0;
    for (std::size_t k = 0; k < measured.position.size() && k < goal.size(); ++k)
      worst = std::max(worst, std::abs(measured.position[k] - goal[k]));
    if (sent && worst < 0.01) {
      std::cout << "at the goal" << std::endl;
      return 0;
    }
  }
  return 1;
}
