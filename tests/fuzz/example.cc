#include <glog/logging.h>
#include <sys/mman.h>
#include <unistd.h>

#include "fuzz/targets.h"

namespace saltus::fuzz {

const Scene& ExampleScene() {
  static const Scene& scene = *[] {
    auto* example = new Scene;
    example->name = "example";
    example->steps = 4;
    example->bodies = {{.name = "a", .radius = 0.1, .position = {0, 1}},
                       {.name = "a-a", .radius = 0.1, .position = {1, 1}},
                       {.name = "post.1", .radius = 0.1, .fixed = true, .position = {2, 1}},
                       {.name = "b-a", .radius = 0.1, .position = {3, 1}}};
    example->planes = {{.name = "a-b", .point = {0, 0}, .normal = {0, 1}}};
    example->control = {.bodies = {0, 3}, .initial = {Vec2d(1, 0), Vec2d(0, 1)}};
    example->objective.terminal = {{.body = 0}};
    example->optimize = Optimize::kControl;
    CHECK(!Validate(*example));
    return example;
  }();
  return scene;
}

std::string FileWith(std::string_view bytes) {
  static const int file = memfd_create("input", MFD_CLOEXEC);
  PCHECK(file >= 0 && ftruncate(file, 0) == 0);
  PCHECK(pwrite(file, bytes.data(), bytes.size(), 0) == static_cast<ssize_t>(bytes.size()));
  return "/proc/self/fd/" + std::to_string(file);
}

}  // namespace saltus::fuzz
