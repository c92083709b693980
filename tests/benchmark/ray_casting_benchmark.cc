#include <benchmark/benchmark.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <nanoflann.hpp>
#include <optional>
#include <random>
#include <vector>

#include "acoustics/config.h"
#include "geometry/angles.h"
#include "ray_casting/range_index.h"
#include "tests/benchmark/require.h"
#include "tests/benchmark/room.h"

// Section V for one audio scan: an index of the LIDAR points by direction as seen from the array,
// and the nearest point of each candidate direction.
namespace soundmap::benchmarks {
namespace {

using Points = std::vector<Eigen::Vector3f>;
using Directions = std::vector<Eigen::Vector3d>;

constexpr double kMaxAngle_rad = geometry::RadFromDeg(3.0);
constexpr int kNone = -1;

struct Scene {
  Points points;
  Eigen::Vector3d origin{0.1, 0.0, 0.3};
  Directions directions;
  ray_casting::LookUpDirections look_up;  // made once for all scans of a robot
};

Scene MakeScene(const geometry::DirectionGrid& grid) {
  std::mt19937_64 random(1);
  return {.points = LidarPoints(MapFromSensor(1, 7), random),
          .directions = {grid.begin(), grid.end()},
          .look_up{grid, kMaxAngle_rad}};
}

// The v_L(j) of the points.
std::vector<std::array<float, 3>> UnitVectors(const Scene& scene) {
  std::vector<std::array<float, 3>> unit;
  unit.reserve(scene.points.size());
  for (const Eigen::Vector3f& point : scene.points) {
    const Eigen::Vector3f v = (point - scene.origin.cast<float>()).normalized();
    unit.push_back({v.x(), v.y(), v.z()});
  }
  return unit;
}

// Each method is made ready for the points of a scan, as often as there are scans, and then finds
// the nearest point of every direction.
class Ours {
 public:
  explicit Ours(const Scene& scene) : scene_(scene) { Make(); }
  void Make() {
    index_.Make(scene_.points, Eigen::Isometry3d(Eigen::Translation3d(scene_.origin)));
  }
  std::vector<std::int32_t> Nearest() const { return index_.Nearest(scene_.look_up); }

 private:
  const Scene& scene_;
  ray_casting::RangeIndex index_;
};

struct Cloud {
  std::vector<std::array<float, 3>> points;
  std::size_t kdtree_get_point_count() const { return points.size(); }
  float kdtree_get_pt(std::size_t point, std::size_t axis) const { return points[point][axis]; }
  template <typename Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};

class KdTree {
 public:
  explicit KdTree(const Scene& scene) : scene_(scene) { Make(); }
  void Make() {
    cloud_.points = UnitVectors(scene_);
    tree_.emplace(3, cloud_, nanoflann::KDTreeSingleIndexAdaptorParams(10));
  }
  std::vector<int> Nearest() const {
    const Directions& directions = scene_.directions;
    const double chord = 2.0 * std::sin(0.5 * kMaxAngle_rad);
    std::vector<int> nearest;
    nearest.reserve(directions.size());
    for (const Eigen::Vector3d& direction : directions) {
      const Eigen::Vector3f query = direction.cast<float>();
      std::uint32_t point = 0;
      float distance2 = 0.0f;
      const bool found =
          tree_->knnSearch(query.data(), 1, &point, &distance2) == 1 && distance2 < chord * chord;
      nearest.push_back(found ? static_cast<int>(point) : kNone);
    }
    return nearest;
  }

 private:
  const Scene& scene_;
  Cloud cloud_;
  std::optional<
      nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, Cloud>, Cloud, 3>>
      tree_;
};

// The largest of all products v_L . v_a, as a matrix product.
class BruteForce {
 public:
  explicit BruteForce(const Scene& scene) : scene_(scene), unit_(UnitVectors(scene)) {}

  std::vector<int> Nearest() const {
    const Directions& directions = scene_.directions;
    constexpr Eigen::Index kBlock = 2048;  // products of one direction that stay in the cache
    const Eigen::Map<const Eigen::Matrix3Xf> v_l(unit_.front().data(), 3,
                                                 static_cast<Eigen::Index>(unit_.size()));
    std::vector<int> nearest;
    nearest.reserve(directions.size());
    Eigen::VectorXf dot;
    for (const Eigen::Vector3d& direction : directions) {
      const Eigen::Vector3f v_a = direction.cast<float>();
      auto best = static_cast<float>(std::cos(kMaxAngle_rad));
      Eigen::Index point = kNone;
      for (Eigen::Index first = 0; first < v_l.cols(); first += kBlock) {
        const Eigen::Index count = std::min(kBlock, v_l.cols() - first);
        dot.noalias() = v_l.middleCols(first, count).transpose() * v_a;
        if (!(dot.maxCoeff() > best)) continue;
        Eigen::Index place = 0;
        best = dot.maxCoeff(&place);
        point = first + place;
      }
      nearest.push_back(static_cast<int>(point));
    }
    return nearest;
  }

 private:
  const Scene& scene_;
  std::vector<std::array<float, 3>> unit_;
};

// Points at one angle are as good as each other: the angles must agree to float precision.
void RequireAgreement(const Scene& scene, const std::vector<int>& found, const char* what) {
  const std::vector<int> ours = Ours(scene).Nearest();
  int differences = 0;
  for (std::size_t i = 0; i < ours.size(); ++i) {
    const auto angle_rad = [&](int point) {
      if (point == kNone) return kMaxAngle_rad;
      const Eigen::Vector3d v = scene.points[point].cast<double>() - scene.origin;
      return std::atan2(v.cross(scene.directions[i]).norm(), v.dot(scene.directions[i]));
    };
    constexpr double kFloat_rad = 1e-3;  // the products of floats tell angles no better near 0
    differences += std::abs(angle_rad(ours[i]) - angle_rad(found[i])) > kFloat_rad;
  }
  Require(differences == 0, what);
}

template <typename Method>
void TimeIndex(const std::string& name, const std::shared_ptr<const Scene>& scene) {
  benchmark::RegisterBenchmark(("range_index/30000/" + name).c_str(), [scene](
                                                                          benchmark::State& state) {
    Method method(*scene);
    for (auto _ : state) {
      method.Make();
      benchmark::ClobberMemory();
    }
  })->Unit(benchmark::kMillisecond);
}

template <typename Method>
void TimeLookup(const std::string& name, const std::shared_ptr<const Scene>& scene) {
  const auto method = std::make_shared<const Method>(*scene);
  benchmark::RegisterBenchmark(("range_lookup/" + name).c_str(), [scene,
                                                                  method](benchmark::State& state) {
    for (auto _ : state) benchmark::DoNotOptimize(method->Nearest());
    state.SetItemsProcessed(
        static_cast<std::int64_t>(state.iterations() * scene->directions.size()));
  })->Unit(benchmark::kMillisecond);
}

void Register(const std::string& directions, const geometry::DirectionGrid& grid) {
  const auto scene = std::make_shared<const Scene>(MakeScene(grid));
  RequireAgreement(*scene, KdTree(*scene).Nearest(), "the k-d tree finds other points");
  RequireAgreement(*scene, BruteForce(*scene).Nearest(), "brute force finds other points");
  TimeLookup<Ours>(directions + "/ours", scene);
  TimeLookup<KdTree>(directions + "/nanoflann", scene);
  TimeLookup<BruteForce>(directions + "/brute_force", scene);
}

}  // namespace
}  // namespace soundmap::benchmarks

int main(int argc, char** argv) {
  using soundmap::acoustics::AcousticsConfig;
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  using namespace soundmap::benchmarks;
  const auto scene = std::make_shared<const Scene>(MakeScene(AcousticsConfig::Paper().MakeGrid()));
  TimeIndex<Ours>("ours", scene);
  TimeIndex<KdTree>("nanoflann", scene);
  Register("paper_4636", AcousticsConfig::Paper().MakeGrid());
  Register("default_10312", AcousticsConfig::Default().MakeGrid());
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
