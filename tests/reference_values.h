// Values that tests compare with: files of data/, which others than this library have computed.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

namespace saltus {

// A JSON file of data/, "exact_references.json", read once. Throws if there is none.
const nlohmann::json& ReferenceFile(const std::string& name);

// The number that a string holds, as those files have it.
double Number(const nlohmann::json& text);

}  // namespace saltus
