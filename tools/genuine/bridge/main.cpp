// Start a system of the dVRK and its ROS bridge without Qt: dvrk SYSTEM.json [PERIOD [TF_PERIOD]].
#include <clocale>
#include <csignal>
#include <cstdlib>
#include <iostream>
#include <unistd.h>
#include <cisstCommon/cmnPath.h>
#include <cisstMultiTask/mtsManagerLocal.h>
#include <cisst_ros_bridge/mtsROSBridge.h>
#include <dvrk_utilities/system_ROS.h>
#include <sawIntuitiveResearchKit/mtsIntuitiveResearchKit.h>
#include <sawIntuitiveResearchKit/system.h>

static volatile std::sig_atomic_t stopped = 0;

static void stop(int) { stopped = 1; }

int main(int argc, char ** argv)
{
    std::setlocale(LC_ALL, "C");
    mtsIntuitiveResearchKit::Logger logger;
    cisst_ral::ral ral(argc, argv, "dvrk");
    const auto words = ral.stripped_arguments();
    if (words.size() < 2) {
        std::cerr << "usage: dvrk SYSTEM.json [PERIOD [TF_PERIOD]]" << std::endl;
        return 2;
    }
    const double period = words.size() > 2 ? std::atof(words[2].c_str()) : 0.01;
    const double tf_period = words.size() > 3 ? std::atof(words[3].c_str()) : 0.02;

    auto * manager = mtsManagerLocal::GetInstance();
    auto * system = new dvrk::system("system");
    system->Configure(cmnPath::Exists(words[1]) ? words[1] : system->find_file(words[1]));
    manager->AddComponent(system);
    system->Connect();
    auto * bridge = new dvrk::system_ROS("dvrk_robot", ral.node(), period, tf_period, system);
    manager->AddComponent(bridge);
    bridge->Connect();
    manager->CreateAllAndWait(5.0);
    manager->StartAllAndWait(5.0);
    std::signal(SIGINT, stop);
    std::signal(SIGTERM, stop);
    std::cout << "READY" << std::endl;
    while (!stopped) {
        usleep(100000);
    }
    manager->KillAllAndWait(2.0);
    manager->Cleanup();
    logger.Stop();
    cisst_ral::shutdown();
    return 0;
}
