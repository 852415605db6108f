#include <glog/logging.h>

#include <charconv>
#include <cmath>

#include "fuzz/targets.h"
#include "sweep/study.h"

namespace saltus::fuzz {
namespace {

// Checks a row: it has as many values as options, each of which a request takes or refuses with a reason.
void CheckRow(const SweepBlock& block, const SweepRow& row) {
  CHECK_EQ(row.size(), block.options.size());
  Request request;
  request.scene = ExampleScene();
  request.options.surrogate.emplace();
  request.options.descent.learning_rate = 1;
  for (size_t j = 0; j < row.size(); ++j) {
    const SweepOptionKind kind = FindSweepOption(block.options[j], request.scene).value();
    if (kind == SweepOptionKind::kWord) {
      CHECK(!row[j].get<std::string>().empty());
    } else {
      CHECK(std::isfinite(ToNumber(row[j])));
    }
    try {
      SetSweepOption(block.options[j], row[j], &request);
    } catch (const InputError& error) {
      CHECK_NE(error.what(), std::string());
      return;
    }
  }
  Validate(request.scene);
}

// Whether a range asks for more values than are worth the time.
bool HasLongRange(std::string_view text) {
  constexpr double kLong = 1000;
  for (const std::string_view scale : {"lin", "log"}) {
    for (size_t at = text.find(scale); at != std::string_view::npos; at = text.find(scale, at + 1)) {
      const size_t count = text.find_first_not_of(": \t\n\v\f\r+", at + scale.size());
      double value = 0;
      if (count == std::string_view::npos) continue;
      if (std::from_chars(text.data() + count, text.data() + text.size(), value).ec == std::errc() && value > kLong) {
        return true;
      }
    }
  }
  return false;
}

void ReadsSpec(const std::string& text) {
  try {
    for (const SweepBlock& block : ParseSweep(text, ExampleScene())) {
      CHECK(!block.options.empty() && !block.rows.empty());
      // Every row of what was written out, some of a long range.
      const size_t stride = std::max<size_t>(1, block.rows.size() / 100);
      for (size_t i = 0; i < block.rows.size(); i += stride) CheckRow(block, block.rows[i]);
      CheckRow(block, block.rows.back());
    }
  } catch (const InputError& error) {
    CHECK_NE(error.what(), std::string());
  }
}

}  // namespace

void ReadsSweep(std::string_view bytes) {
  if (bytes.find('@') != std::string_view::npos) return;  // would read any file there is; see ReadsPoints
  if (HasLongRange(bytes)) return;
  ReadsSpec(std::string(bytes));
}

void ReadsPoints(std::string_view bytes) { ReadsSpec("@" + FileWith(bytes) + "; learning_rate=1,2"); }

}  // namespace saltus::fuzz
