#include <cstdio>
#include <filesystem>
#include <memory>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "cli/tune.h"

namespace soundmap::cli {
namespace {

std::string Quoted(const std::string& text) { return absl::StrCat("\"", text, "\""); }

// Three panels side by side; the sets of parameters have numbers, and names in the last key.
constexpr char kPanels[] = R"(
set multiplot layout 1,3
set key top left
set style data histograms
set style fill solid 0.8
set yrange [0:*]
set offsets graph 0, 0, graph 0.3, 0
set xlabel 'set of parameters'
set title 'sources'
plot $sets using 2:xtic(1) title 'in view', '' using 3 title 'detected', \
     '' using 4 title 'false', '' using 5 title 'double'
set title 'distance from the true source, mean [m]'
plot $sets using 6:xtic(1) notitle
set title 'reliability'
set offsets
set xlabel 'probability of candidates'
set ylabel 'share of them that are sources'
set xtics autofreq
set xrange [0:1]
set yrange [0:1]
set key below left maxcols 1 Left reverse
)";

}  // namespace

absl::Status PlotScores(const std::vector<SetScore>& scores, const std::string& path) {
  const std::string extension = std::filesystem::path(path).extension().string();
  if (extension != ".svg" && extension != ".png") {
    return absl::InvalidArgumentError(absl::StrCat(path, " is neither an .svg nor a .png file"));
  }
  if (path.find_first_of("'\n") != std::string::npos) {
    return absl::InvalidArgumentError(absl::StrCat("cannot write a plot to ", path));
  }
  std::string script =
      absl::StrCat("set terminal ", extension == ".svg" ? "svg" : "pngcairo",
                   " noenhanced size 1800,600\nset output '", path, "'\n", "$sets << EOD\n");
  for (std::size_t i = 0; i < scores.size(); ++i) {
    const SetScore& score = scores[i];
    absl::StrAppend(&script, i + 1, " ", score.sources.true_count, " ", score.sources.detected, " ",
                    score.sources.false_count, " ", score.sources.double_count, " ",
                    score.sources.error_mean_m ? absl::StrCat(*score.sources.error_mean_m) : "NaN",
                    "\n");
  }
  absl::StrAppend(&script, "EOD\n");
  std::string reliability = "plot x with lines dashtype 2 linecolor 'gray' title 'calibrated'";
  for (std::size_t i = 0; i < scores.size(); ++i) {
    const std::string title = Quoted(absl::StrCat(i + 1, ": ", Describe(scores[i].set)));
    if (scores[i].calibration.bins.empty()) {
      absl::StrAppend(&reliability, ", NaN with points linecolor 'white' title ", title);
      continue;
    }
    absl::StrAppend(&script, "$set", i, " << EOD\n");
    for (const Calibration::Bin& bin : scores[i].calibration.bins) {
      absl::StrAppendFormat(&script, "%g %g\n", bin.mean_probability, bin.share_of_sources);
    }
    absl::StrAppend(&script, "EOD\n");
    absl::StrAppend(&reliability, ", $set", i, " with linespoints title ", title);
  }
  absl::StrAppend(&script, kPanels, reliability, "\nunset multiplot\n");

  std::FILE* gnuplot = popen("gnuplot", "w");
  if (gnuplot == nullptr) return absl::InternalError("cannot start gnuplot");
  std::fwrite(script.data(), 1, script.size(), gnuplot);
  const int status = pclose(gnuplot);
  constexpr int kNoSuchCommand = 127;
  if (WIFEXITED(status) && WEXITSTATUS(status) == kNoSuchCommand) {
    return absl::FailedPreconditionError(
        "plots are drawn by gnuplot, which is not installed (Debian: gnuplot-nox)");
  }
  if (status != 0) return absl::InternalError(absl::StrCat("gnuplot could not draw ", path));
  return absl::OkStatus();
}

}  // namespace soundmap::cli
