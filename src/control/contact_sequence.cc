#include "saltus/control/contact_sequence.h"

#include <algorithm>
#include <unordered_map>
#include <utility>

namespace saltus {
namespace {

std::string Names(const Scene& scene, const Candidate& c, const char* between = " and ") {
  return scene.bodies[c.a].name + between + (c.plane ? scene.planes[c.b].name : scene.bodies[c.b].name);
}

struct NamedIndex {
  int index = 0;
  bool plane = false;
};
using IndicesByName = std::unordered_map<std::string_view, NamedIndex>;

IndicesByName NamesIn(const Scene& scene) {
  IndicesByName things;
  for (int i = 0; i < scene.num_bodies(); ++i) things.emplace(scene.bodies[i].name, NamedIndex{i, false});
  for (size_t j = 0; j < scene.planes.size(); ++j) {
    things.emplace(scene.planes[j].name, NamedIndex{static_cast<int>(j), true});
  }
  return things;
}

// Returns every pair that `text` may name: more than one is possible, as names may have hyphens.
ContactSequence FindPairs(const Scene& scene, const IndicesByName& things, std::string_view text) {
  ContactSequence found;
  for (size_t hyphen = text.find('-'); hyphen != std::string_view::npos; hyphen = text.find('-', hyphen + 1)) {
    const auto first = things.find(text.substr(0, hyphen)), second = things.find(text.substr(hyphen + 1));
    if (first == things.end() || second == things.end()) continue;
    NamedIndex a = first->second, b = second->second;
    if (a.plane || (!b.plane && a.index > b.index)) std::swap(a, b);
    if (a.plane || (!b.plane && a.index == b.index)) continue;
    const bool moves = !scene.bodies[a.index].fixed || (!b.plane && !scene.bodies[b.index].fixed);
    if (!moves) continue;
    const Candidate pair{a.index, b.index, b.plane};
    if (std::find(found.begin(), found.end(), pair) == found.end()) found.push_back(pair);
  }
  return found;
}

// Lists the pairs of a scene, or the first of very many.
std::string ListPairs(const Scene& scene) {
  constexpr size_t kMost = 50;
  std::string list;
  const ContactSequence pairs = AllPairs(scene);
  for (size_t i = 0; i < std::min(pairs.size(), kMost); ++i) {
    list += (list.empty() ? "" : ", ") + Names(scene, pairs[i], "-");
  }
  if (list.empty()) return "pairs, of which this scene has none";
  return list + (pairs.size() > kMost ? ", ..." : "");
}

}  // namespace

ContactSequence AllPairs(const Scene& scene) {
  ContactSequence pairs;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    for (int j = i + 1; j < scene.num_bodies(); ++j) {
      if (!scene.bodies[i].fixed || !scene.bodies[j].fixed) pairs.push_back({i, j, false});
    }
  }
  for (int i = 0; i < scene.num_bodies(); ++i) {
    for (size_t j = 0; j < scene.planes.size() && !scene.bodies[i].fixed; ++j) {
      pairs.push_back({i, static_cast<int>(j), true});
    }
  }
  return pairs;
}

std::string NonPlaneGeometry(const Scene& scene) {
  if (scene.HasEdges()) return "walls that end (segments, polygons or arcs)";
  if (!scene.pockets.empty()) return "pockets that discs fall into";
  if (scene.table) return "a table that discs slide on";
  return "";
}

std::string NonBallisticForces(const Scene& scene) {
  if (!scene.forces.empty()) return "drag or springs";
  return scene.HasPaths() ? "prescribed motions" : "";
}

std::string NonBallisticFeatures(const Scene& scene) {
  std::string beyond = NonPlaneGeometry(scene);
  if (beyond.empty()) beyond = NonBallisticForces(scene);
  return beyond.empty() && scene.Spins() ? "discs that spin" : beyond;
}

std::string ParseContactSequence(const Scene& scene, std::string_view text, ContactSequence* sequence) {
  sequence->clear();
  if (text == "none") return "";
  const IndicesByName things = NamesIn(scene);
  while (true) {
    const size_t comma = text.find(',');
    const std::string pair(text.substr(0, comma));
    const ContactSequence found = FindPairs(scene, things, pair);
    if (found.empty()) {
      return "'" + pair + "' is no pair that can collide; expected 'none' or a comma-separated list of " +
             ListPairs(scene);
    }
    if (found.size() > 1) {
      return "'" + pair + "' could be " + Names(scene, found[0]) + ", or " + Names(scene, found[1]) +
             "; expected names with one reading (try them the other way round)";
    }
    sequence->push_back(found[0]);
    if (comma == std::string_view::npos) return "";
    text.remove_prefix(comma + 1);
  }
}

std::string ContactSequenceToString(const Scene& scene, const ContactSequence& sequence) {
  std::string text;
  for (const Candidate& c : sequence) text += (text.empty() ? "" : ",") + Names(scene, c, "-");
  return text.empty() ? "none" : text;
}

}  // namespace saltus
