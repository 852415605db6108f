// Boxes that are tossed until they rest, scenes that rest from the start, and columns that move (resting_boxes.h): what
// goes wrong, a line
// each, and how often what was found. Fails if anything goes wrong, or if more than 1 % of the tosses have no motion.
#include "campaign/resting_boxes.h"

#include <gflags/gflags.h>

#include <map>

DEFINE_int32(tosses, 2000, "how many boxes are tossed");
DEFINE_int32(scenes, 500, "how many scenes that rest from the start");
DEFINE_int32(columns, 0, "how many columns of boxes that move along the ground");
DEFINE_int32(seed, 1, "of the first of each; the next has the next");
DEFINE_int32(compare_every, 20, "compare one toss in so many with time stepping");

namespace {

struct Counts {
  int all = 0, wrong = 0, refused = 0, rests = 0, impacts = 0, compared = 0;
  double deviation = 0;
  std::map<std::string, int> reasons;

  void Add(const char* what, int seed, const saltus::RestingReport& report) {
    ++all;
    if (!report.wrong.empty()) std::printf("%s %d: %s\n", what, seed, report.wrong.c_str());
    if (!report.refused.empty()) {
      std::printf("%s %d has no motion: %s\n", what, seed, report.refused.c_str());
      ++reasons[report.refused.substr(0, report.refused.find_first_of(":("))];
    }
    wrong += report.wrong.empty() ? 0 : 1;
    refused += report.refused.empty() ? 0 : 1;
    rests += report.rests ? 1 : 0;
    impacts += report.impacts;
    compared += report.compared ? 1 : 0;
    deviation = std::max(deviation, report.deviation);
  }
  void Print(const char* what) const {
    std::printf("%d %s: %d rest at the end, %d have no motion, %d are wrong; %d impacts; largest deviation %.3g\n",
                all,
                what,
                rests,
                refused,
                wrong,
                impacts,
                deviation);
    for (const auto& [reason, count] : reasons) std::printf("  %d: %s\n", count, reason.c_str());
  }
};

}  // namespace

int main(int argc, char** argv) {
  gflags::ParseCommandLineFlags(&argc, &argv, /*remove_flags=*/true);
  Counts tosses, scenes, columns;
  for (int i = 0; i < FLAGS_tosses; ++i) {
    const int seed = FLAGS_seed + i;
    const bool compare = FLAGS_compare_every > 0 && i % FLAGS_compare_every == 0;
    tosses.Add("toss", seed, saltus::TossUntilRest(seed).Run(compare));
  }
  for (int i = 0; i < FLAGS_scenes; ++i) {
    const int seed = FLAGS_seed + i;
    scenes.Add("scene", seed, saltus::RestingScene(seed).Run());
  }
  for (int i = 0; i < FLAGS_columns; ++i) {
    const int seed = FLAGS_seed + i;
    columns.Add("column", seed, saltus::MovingColumn(seed).Run(/*duration=*/1, /*steps=*/0));
  }
  tosses.Print("tosses");
  std::printf("  %d compared with time stepping\n", tosses.compared);
  scenes.Print("scenes");
  columns.Print("columns");
  return tosses.wrong + scenes.wrong + columns.wrong + scenes.refused == 0 && 100 * tosses.refused <= tosses.all ? 0
                                                                                                                 : 1;
}
