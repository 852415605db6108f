#include "reference_values.h"

#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

#include "folders.h"

namespace saltus {

const nlohmann::json& ReferenceFile(const std::string& name) {
  static std::map<std::string, nlohmann::json> files;
  auto found = files.find(name);
  if (found == files.end()) {
    std::ifstream file(SourceFolder() + "/data/" + name);
    found = files.emplace(name, nlohmann::json::parse(file)).first;
  }
  return found->second;
}

double Number(const nlohmann::json& text) { return std::stod(text.get<std::string>()); }

}  // namespace saltus
