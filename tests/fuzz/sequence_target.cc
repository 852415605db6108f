#include <glog/logging.h>

#include "fuzz/targets.h"
#include "saltus/control/contact_sequence.h"

namespace saltus::fuzz {

void ReadsSequence(std::string_view bytes) {
  const Scene& scene = ExampleScene();
  ContactSequence sequence, again;
  if (!ParseContactSequence(scene, bytes, &sequence).empty()) return;
  for (const Candidate& c : sequence) {
    CHECK(0 <= c.a && c.a < scene.num_bodies());
    CHECK(0 <= c.b && c.b < (c.plane ? static_cast<int>(scene.planes.size()) : scene.num_bodies()));
    CHECK(!scene.bodies[c.a].fixed || (!c.plane && !scene.bodies[c.b].fixed));
  }
  const std::string text = ContactSequenceToString(scene, sequence);
  // With discs in the other order the text may have a second reading.
  const std::string wrong = ParseContactSequence(scene, text, &again);
  CHECK(wrong.empty() ? again == sequence : wrong.find("could be") != std::string::npos) << text << ": " << wrong;
}

}  // namespace saltus::fuzz
