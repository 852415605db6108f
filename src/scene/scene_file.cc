#include "saltus/scene/scene_file.h"

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "scene/scene_reader.h"
#include "scene/yaml_value.h"

namespace saltus {
namespace {

SceneFileError CannotRead(const std::string& path, const std::string& why) {
  return {path, 0, "", "cannot read: " + why + "; expected a scene file"};
}

// Reads the file, or only its beginning if it is longer than allowed, into `text`.
std::optional<SceneFileError> ReadText(const std::string& path, std::string* text) {
  std::error_code status;
  if (std::filesystem::is_directory(path, status)) return CannotRead(path, "it is a directory");
  std::ifstream file(path, std::ios::binary);
  if (!file) return CannotRead(path, std::strerror(errno));
  text->assign(kMaxSceneBytes + 1, '\0');  // one more than allowed, to see that there is more
  file.read(text->data(), static_cast<std::streamsize>(text->size()));
  if (file.bad()) return CannotRead(path, std::strerror(errno));
  text->resize(static_cast<std::size_t>(file.gcount()));
  return std::nullopt;
}

}  // namespace

std::optional<SceneFileError> internal::ReadYaml(std::string_view text, const std::string& name, const UseTree& use) {
  try {
    use(LoadYaml(text));
    return std::nullopt;
  } catch (const SceneFileFailure& failure) {
    return SceneFileError{name, failure.line, failure.key, failure.message};
  } catch (const YAML::Exception& error) {
    return SceneFileError{name,
                          error.mark.is_null() ? 1 : error.mark.line + 1,
                          "",
                          "found text that is not YAML (" + error.msg + "), expected a scene"};
  }
}

std::optional<SceneFileError> internal::ReadYamlFile(const std::string& path, const UseTree& use) {
  std::string text;
  if (std::optional<SceneFileError> error = ReadText(path, &text)) return error;
  return ReadYaml(text, path, use);
}

std::string SceneFileError::ToString() const {
  std::string text = file;
  if (line > 0) text += ':' + std::to_string(line);
  if (!key.empty()) text += ": " + key;
  return text + ": " + message;
}

std::variant<Scene, SceneFileError> ParseScene(std::string_view text, const std::string& name) {
  Scene scene;
  const std::optional<SceneFileError> error = internal::ReadYaml(text, name, [&](const YAML::Node& root) {
    internal::SceneReader reader;
    scene = reader.Read(root);
    if (const auto wrong = Validate(scene)) {
      throw internal::SceneFileFailure{reader.LineOf(wrong->key), wrong->key, wrong->message};
    }
  });
  if (error) return *error;
  return scene;
}

std::variant<Scene, SceneFileError> LoadSceneFile(const std::string& path) {
  std::string text;
  if (const std::optional<SceneFileError> error = ReadText(path, &text)) return *error;
  return ParseScene(text, path);
}

}  // namespace saltus
