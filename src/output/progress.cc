#include "output/progress.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/number_text.h"
#include "base/table.h"

namespace saltus {
namespace {

constexpr double kBarPeriod = 0.1;   // s
constexpr double kLinePeriod = 5.0;  // s
constexpr size_t kDefaultColumns = 80;
constexpr size_t kMinBar = 10;
constexpr size_t kMaxBar = 40;

// Returns 83 s as "1:23", two hours as "2:00:00".
std::string Duration(double seconds) {
  const auto s = static_cast<int>(std::llround(std::clamp(seconds, 0.0, 1e9)));
  if (s < 3600) return FormatNumbers("%.0f:%02.0f", s / 60, s % 60);
  return FormatNumbers("%.0f:%02.0f:%02.0f", s / 3600, s / 60 % 60, s % 60);
}

bool IsFinished(const ProgressState& state) { return state.total > 0 && state.done >= state.total; }

double Fraction(const ProgressState& state) {
  return std::clamp(static_cast<double>(state.done) / static_cast<double>(state.total), 0.0, 1.0);
}

// Returns the numbers of a line: "512/1000  51%  128/s  0:04 left".
std::string Figures(const ProgressState& state) {
  std::string text = std::to_string(state.done);
  if (state.total > 0) {
    text += "/" + std::to_string(state.total) + FormatNumbers(" %3.0f%%", std::floor(100 * Fraction(state)));
  }
  const bool measured = state.done > 0 && state.elapsed > 0;
  if (measured && state.alike) text += FormatNumbers("  %.3g/s", static_cast<double>(state.done) / state.elapsed);
  const std::string passed = "  " + Duration(state.elapsed);
  if (IsFinished(state) || state.ended || state.total <= 0 || !measured || !state.alike) return text + passed;
  // The estimate is from the time of the finished units. Once it has proved too short, it is not shown.
  const double until = state.last_done > 0 ? state.last_done : state.elapsed;
  const double whole = until * static_cast<double>(state.total) / static_cast<double>(state.done);
  return whole < state.elapsed ? text + passed : text + "  " + Duration(whole - state.elapsed) + " left";
}

}  // namespace

std::optional<ProgressMode> ParseProgressMode(std::string_view word) {
  if (word == "auto") return ProgressMode::kAuto;
  if (word == "plain") return ProgressMode::kPlain;
  if (word == "none") return ProgressMode::kNone;
  return std::nullopt;
}

std::string ProgressBar(const ProgressState& state, size_t columns) {
  const std::string figures = Figures(state);
  const std::string note = state.note.empty() ? "" : "  " + state.note;
  const size_t others = state.name.size() + figures.size() + note.size() + 4;  // " [", "] "
  std::string bar;
  if (state.total > 0) {
    const size_t width = std::clamp(columns > others ? columns - others : 0, kMinBar, kMaxBar);
    const size_t filled = static_cast<size_t>(Fraction(state) * static_cast<double>(width));
    bar = std::string(filled, '=') + std::string(width - filled, ' ');
    if (0 < filled && filled < width) bar[filled - 1] = '>';
    bar = " [" + bar + "]";
  }
  const std::string line = state.name + bar + " " + figures + note;
  return line.substr(0, PrefixOf(line, columns));
}

std::string ProgressLine(const ProgressState& state) {
  return state.name + ": " + Figures(state) + (state.note.empty() ? "" : "  " + state.note);
}

Progress::Progress(ProgressMode mode, std::FILE* sink, std::string name, int64_t total, Clock clock)
    : sink_(sink),
      silent_(mode == ProgressMode::kNone),
      bar_(mode == ProgressMode::kAuto && isatty(fileno(sink)) != 0),
      clock_(std::move(clock)),
      start_(clock_()),
      state_{.name = std::move(name), .total = total, .note = ""},
      next_report_(bar_ ? kBarPeriod : kLinePeriod) {}

Progress::~Progress() { Finish(); }

double Progress::Seconds() const { return std::chrono::duration<double>(clock_() - start_).count(); }

void Progress::Advance(int64_t units, std::string_view note) {
  const std::lock_guard lock(mutex_);
  if (units > 0) state_.last_done = Seconds();
  state_.done += units;
  Report(note);
}

void Progress::UnitsDiffer() {
  const std::lock_guard lock(mutex_);
  state_.alike = false;
}

void Progress::Report(std::string_view note) {
  if (silent_) return;
  const double now = Seconds();
  if (now < next_report_) return;
  next_report_ = now + (bar_ ? kBarPeriod : kLinePeriod);
  state_.note = note;
  Draw();
}

void Progress::Draw() {
  state_.elapsed = Seconds();
  if (bar_) {
    // One column is left free: some terminals wrap a full line. "\033[K" erases what a longer line left.
    std::fprintf(sink_, "\r%s\033[K", ProgressBar(state_, TerminalColumns(sink_, kDefaultColumns) - 1).c_str());
  } else {
    std::fprintf(sink_, "%s\n", ProgressLine(state_).c_str());
  }
  std::fflush(sink_);
}

void Progress::Finish() {
  const std::lock_guard lock(mutex_);
  if (std::exchange(silent_, true)) return;
  state_.ended = true;
  state_.note = state_.total > 0 && !IsFinished(state_) ? "stopped" : "done";
  Draw();
  if (bar_) std::fprintf(sink_, "\n");
  std::fflush(sink_);
}

}  // namespace saltus
