#include "reference_values.h"

#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

#include "folders.h"

namespace saltus {

const nlohmann::json& ReferenceFile(const std::string& name) {
  static std::map<std::string, nlohmann::json> files;
  const auto [found, is_new] = files.try_emplace(name);
  if (is_new) {
    std::ifstream file(SourceFolder() + "/data/" + name);
    found->second = nlohmann::json::parse(file);
  }
  return found->second;
}

double Number(const nlohmann::json& text) { return std::stod(text.get<std::string>()); }

}  // namespace saltus
