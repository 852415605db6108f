#include <glog/logging.h>

#include "fuzz/targets.h"
#include "saltus/scene/scene_file.h"

namespace saltus::fuzz {

void ReadsScene(std::string_view bytes) {
  const std::variant<Scene, SceneFileError> read = ParseScene(bytes, "input");
  if (const auto* error = std::get_if<SceneFileError>(&read)) {
    CHECK(!error->message.empty());
    CHECK_EQ(error->ToString().find('\n'), std::string::npos) << error->ToString();
    return;
  }
  const Scene& scene = std::get<Scene>(read);
  CHECK(!Validate(scene));
  const std::string text = WriteScene(scene);
  const std::variant<Scene, SceneFileError> again = ParseScene(text, "output");
  if (const auto* error = std::get_if<SceneFileError>(&again)) LOG(FATAL) << error->ToString() << "\n" << text;
  CHECK(std::get<Scene>(again) == scene) << text;
}

}  // namespace saltus::fuzz
