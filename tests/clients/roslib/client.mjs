// node client.mjs ws://127.0.0.1:9090 : lists topics, calls services, moves PSM1 and follows it.
import * as ROSLIB from "roslib";

const ros = new ROSLIB.Ros();
const answer = (call) => new Promise((resolve, reject) => call(resolve, reject));
const next = (topic, fits = () => true) =>
  new Promise((resolve) => {
    const listen = (message) => {
      if (fits(message)) {
        topic.unsubscribe(listen);
        resolve(message);
      }
    };
    topic.subscribe(listen);
  });
const topic = (name, messageType, rest = {}) => new ROSLIB.Topic({ ros, name, messageType, ...rest });

await ros.connect(process.argv[2]);
const told = {};

told.topics = await answer((yes, no) => ros.getTopics(yes, no));
told.nodes = await answer((yes, no) => ros.getNodes(yes, no));
told.type = await answer((yes, no) => ros.getTopicType("/PSM1/measured_js", yes, no));
told.services = await answer((yes, no) => ros.getServices(yes, no));
const details = await answer((yes, no) => ros.getMessageDetails("sensor_msgs/JointState", yes, no));
told.details = ros.decodeTypeDefs(details);

told.state = await next(topic("/PSM1/operating_state", "crtk_msgs/OperatingState"));
const measured = topic("/PSM1/measured_js", "sensor_msgs/JointState", { throttle_rate: 20 });
told.before = await next(measured);
const move = topic("/PSM1/move_jp", "sensor_msgs/JointState");
move.publish({ name: [], position: [0.2, 0.0, 0.12, 0.0, 0.0, 0.0], velocity: [], effort: [] });
told.after = await next(measured, (m) => Math.abs(m.position[0] - 0.2) < 1e-3);

const kinematics = new ROSLIB.Service({
  ros,
  name: "/PSM1/local/forward_kinematics",
  serviceType: "crtk_msgs/QueryForwardKinematics",
});
told.pose = await answer((yes, no) =>
  kinematics.callService({ jp: [0.0, 0.0, 0.12, 0.0, 0.0, 0.0] }, yes, no),
);
const absent = new ROSLIB.Service({ ros, name: "/nothing", serviceType: "std_srvs/Trigger" });
told.refused = await answer((yes, no) => absent.callService({}, no, yes));

console.log(JSON.stringify(told));
ros.close();
