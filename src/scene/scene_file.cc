#include "saltus/scene/scene_file.h"

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "scene/scene_reader.h"
#include "scene/yaml_text.h"

namespace saltus {
namespace {

using internal::SceneFileFailure;

Scene ReadScene(std::string_view text) {
  internal::SceneReader reader;
  Scene scene = reader.Read(internal::LoadYaml(text));
  if (const auto error = Validate(scene)) throw SceneFileFailure{reader.LineOf(error->key), error->key, error->message};
  return scene;
}

SceneFileError CannotRead(const std::string& path, const std::string& why) {
  return {path, 0, "", "cannot read: " + why + "; expected a scene file"};
}

}  // namespace

std::string SceneFileError::ToString() const {
  std::string text = file;
  if (line > 0) text += ':' + std::to_string(line);
  if (!key.empty()) text += ": " + key;
  return text + ": " + message;
}

std::variant<Scene, SceneFileError> ParseScene(std::string_view text, const std::string& name) {
  try {
    return ReadScene(text);
  } catch (const SceneFileFailure& failure) {
    return SceneFileError{name, failure.line, failure.key, failure.message};
  } catch (const YAML::Exception& error) {
    return SceneFileError{name,
                          error.mark.is_null() ? 1 : error.mark.line + 1,
                          "",
                          "found text that is not YAML (" + error.msg + "), expected a scene"};
  }
}

std::variant<Scene, SceneFileError> LoadSceneFile(const std::string& path) {
  std::error_code status;
  if (std::filesystem::is_directory(path, status)) return CannotRead(path, "it is a directory");
  std::ifstream file(path, std::ios::binary);
  if (!file) return CannotRead(path, std::strerror(errno));
  std::string text(kMaxSceneBytes + 1, '\0');  // one more than allowed, to see that there is more
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  if (file.bad()) return CannotRead(path, std::strerror(errno));
  text.resize(static_cast<std::size_t>(file.gcount()));
  return ParseScene(text, path);
}

}  // namespace saltus
