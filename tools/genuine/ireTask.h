// Stands in for cisst's embedded Python shell, which does nothing here.
#pragma once
#include <string>
#include <cisstMultiTask/mtsTaskContinuous.h>
class ireTask: public mtsTaskContinuous {
 public:
  ireTask(const std::string & name, int, const std::string &): mtsTaskContinuous(name) {}
  void Configure(const std::string & = "") {}
  void Startup() {}
  void Run() {}
  void Cleanup() {}
};
inline int IRE_ShellFromString(const std::string &) { return 0; }
