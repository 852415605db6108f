// The extension module behind the Python package saltus, which documents it and checks nothing twice.
#include <glog/logging.h>

#include "base/freed_memory.h"
#include "convert.h"

PYBIND11_MODULE(_saltus, module) {
  using namespace saltus::python;
  saltus::KeepFreedMemory();
  FLAGS_minloglevel = google::GLOG_FATAL;  // results say what matters of Ceres' log, exceptions the rest
  module.attr("__version__") = SALTUS_VERSION;
  BindContact(&module);
  BindScene(&module);
  BindSimulation(&module);
  BindBatch(&module);
  BindEndState(&module);
  BindSolve(&module);
  BindAudit(&module);
  BindIdentify(&module);
  BindFeedback(&module);
  BindHybrid(&module);
  BindSweep(&module);
}
