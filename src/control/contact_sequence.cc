#include "saltus/control/contact_sequence.h"

#include <optional>

namespace saltus {
namespace {

std::string PairToString(const Scene& scene, const Candidate& c) {
  return scene.bodies[c.a].name + "-" + (c.plane ? scene.planes[c.b].name : scene.bodies[c.b].name);
}

// The pair that `text` names. Names may have hyphens themselves, so the pairs are written out rather than the text cut.
std::optional<Candidate> FindPair(const Scene& scene, const std::string& text) {
  for (const Candidate& c : AllPairs(scene)) {
    const std::string& a = scene.bodies[c.a].name;
    const std::string& b = c.plane ? scene.planes[c.b].name : scene.bodies[c.b].name;
    if (text == a + "-" + b || text == b + "-" + a) return c;
  }
  return std::nullopt;
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

std::string ParseContactSequence(const Scene& scene, std::string_view text, ContactSequence* sequence) {
  sequence->clear();
  if (text == "none") return "";
  while (true) {
    const size_t comma = text.find(',');
    const std::string pair(text.substr(0, comma));
    const std::optional<Candidate> found = FindPair(scene, pair);
    if (!found) {
      std::string known;
      for (const Candidate& c : AllPairs(scene)) known += (known.empty() ? "" : ", ") + PairToString(scene, c);
      return "'" + pair + "' is no pair that can collide; expected 'none' or a comma-separated list of " +
             (known.empty() ? "pairs, of which this scene has none" : known);
    }
    sequence->push_back(*found);
    if (comma == std::string_view::npos) return "";
    text.remove_prefix(comma + 1);
  }
}

std::string ContactSequenceToString(const Scene& scene, const ContactSequence& sequence) {
  std::string text;
  for (const Candidate& c : sequence) text += (text.empty() ? "" : ",") + PairToString(scene, c);
  return text.empty() ? "none" : text;
}

}  // namespace saltus
