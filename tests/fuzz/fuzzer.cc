// The entry of libFuzzer: runs the target that the environment variable SALTUS_FUZZ_TARGET names.
#include <glog/logging.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "fuzz/targets.h"

namespace {

const saltus::fuzz::Target& ChosenTarget() {
  const char* name = std::getenv("SALTUS_FUZZ_TARGET");
  for (const saltus::fuzz::Target& target : saltus::fuzz::Targets()) {
    if (name != nullptr && std::string_view(name) == target.name) return target;
  }
  LOG(FATAL) << "SALTUS_FUZZ_TARGET: expected the name of a target in tests/fuzz/targets.h";
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const saltus::fuzz::Target& target = ChosenTarget();
  target.run({reinterpret_cast<const char*>(data), size});
  return 0;
}
