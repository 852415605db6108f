#include "programs/input_files.h"

#include <algorithm>
#include <functional>

#include "base/file.h"
#include "output/npz.h"
#include "programs/program.h"

namespace saltus {

Json ParseJson(const std::string& text, const std::string& where, const std::string& expected) {
  if (text.find_first_not_of(" \t\r\n") == std::string::npos) {
    throw InputError(where + ": the file is empty, expected " + expected);
  }
  try {
    return Json::parse(text);
  } catch (const Json::parse_error& error) {
    // `byte` counts from 1, and is one behind the text where that ends too early.
    const size_t at = std::min(error.byte > 0 ? error.byte - 1 : 0, text.size());
    const auto end = text.begin() + static_cast<std::ptrdiff_t>(at);
    const size_t before = text.find_last_of('\n', at == 0 ? 0 : at - 1);
    const size_t start = at == 0 || before == std::string::npos ? 0 : before + 1;
    throw InputError(where + ": line " + std::to_string(1 + std::count(text.begin(), end, '\n')) + ", column " +
                     std::to_string(at - start + 1) + ": found " +
                     (at == text.size() ? "the end of the file" : "text that is not JSON") + ", expected " + expected);
  } catch (const Json::exception&) {
    throw InputError(where + ": found a number that is too large, expected " + expected);
  }
}

void InputReader::Fail(const std::string& key, const std::string& expected) const {
  throw InputError(where_ + ": " + key + ": expected " + expected);
}

namespace {

// Returns the entries as nested lists.
Json ToJson(const NpyArray& array) {
  return std::visit(
      [&](const auto& data) {
        size_t next = 0;
        const std::function<Json(size_t)> part = [&](size_t dimension) -> Json {
          if (dimension == array.shape.size()) return data[next++];
          Json list = Json::array();
          for (int64_t i = 0; i < array.shape[dimension] && next < data.size(); ++i)
            list.push_back(part(dimension + 1));
          return list;
        };
        return part(0);
      },
      array.data);
}

}  // namespace

Json InputReader::ReadDocument(const std::string& path, const std::string& before) const {
  const StatusOr<std::string> bytes = ReadFile(path);
  if (!bytes.ok()) throw InputError(before + bytes.status().message());
  if (bytes->starts_with("PK")) {
    const StatusOr<NpzArrays> arrays = ReadNpz(path);
    if (!arrays.ok()) throw InputError(before + arrays.status().message());
    return DocumentOf(*arrays);
  }
  Json document = ParseJson(*bytes, where_, "an NPZ file or a JSON object");
  if (document.is_object() && document.contains("solve")) document = Json(document["solve"]);
  if (!document.is_object()) Fail("the document", "an object");
  return document;
}

Json InputReader::DocumentOf(const NpzArrays& arrays) const {
  Json document = Json::object();
  for (const auto& [key, array] : arrays) document[key] = ToJson(array);
  // Returns the list under a key, each of its items a list of `columns` if there are any; empty without the key.
  const auto list = [&](const std::string& key, const std::string& expected, size_t columns = 0) {
    Json items = document.value(key, Json::array());
    const auto fits = [&](const Json& item) { return columns == 0 || (item.is_array() && item.size() == columns); };
    if (!items.is_array() || !std::ranges::all_of(items, fits)) Fail(key, expected);
    return items;
  };
  for (const char* text : {"contact", "solver", "scene"}) {
    if (const Json items = document.value(text, Json()); items.is_array() && !items.empty()) document[text] = items[0];
  }
  if (document.contains("scene")) document["scene_file"] = std::move(document["scene"]);
  if (document.contains("control")) document["control_rows"] = std::move(document["control"]);
  document.erase("control");
  const Json radii = list("radius", "one radius for each disc"), names = list("name", "one name for each disc");
  for (size_t i = 0; i < radii.size(); ++i) {
    Json& body = document["bodies"].emplace_back(Json{{"radius", radii[i]}});
    if (i < names.size()) body["name"] = names[i];
  }
  for (const Json& body : list("initial_state", "a shape of (B, 4)", 4)) {
    document["position"].push_back({body[0], body[1]});
    document["velocity"].push_back({body[2], body[3]});
  }
  for (const Json& body : list("initial_rotation", "a shape of (B, 2)", kSpin)) {
    document["angular_velocity"].push_back(body[1]);
  }
  const Json parameters = list("parameter_names", "one name for each parameter");
  if (const Json values = list("parameters", "a list of numbers"); !values.empty() && !parameters.empty()) {
    const bool named = std::ranges::all_of(parameters, [](const Json& name) { return name.is_string(); });
    if (!named || values.size() != parameters.size()) Fail("parameter_names", "one name for each parameter");
    document["parameters"] = Json::object();
    for (size_t i = 0; i < values.size(); ++i) document["parameters"][parameters[i].get<std::string>()] = values[i];
  } else {
    document.erase("parameters");
  }
  for (const std::string prefix : {"", "exact_"}) {
    const std::string shapes = "shapes of (M, 3), (M, 2) and (M, 2)";
    const Json pairs = list(prefix + "touch_pairs", shapes, 3), times = list(prefix + "touch_times", shapes, 2);
    const Json impulses = list(prefix + "touch_impulses", shapes, 2);
    if (times.size() != pairs.size() || (!impulses.empty() && impulses.size() != pairs.size())) {
      Fail(prefix + "touch_times", shapes);
    }
    for (size_t i = 0; i < pairs.size(); ++i) {
      Json& touch = document[prefix + "touches"].emplace_back(
          Json{{"a", pairs[i][0]}, {"b", pairs[i][1]}, {"wall", pairs[i][2] != 0}});
      touch.update({{"begin", times[i][0]}, {"end", times[i][1]}});
      if (!impulses.empty()) touch["impulse"] = impulses[i];
    }
  }
  return document;
}

}  // namespace saltus
