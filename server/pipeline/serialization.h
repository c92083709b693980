#pragma once

// Boost.Serialization of the types that the pipeline stores. Included by the two sources that write
// archives.

#include <algorithm>
#include <boost/archive/archive_exception.hpp>
#include <boost/archive/binary_iarchive.hpp>
#include <boost/archive/binary_oarchive.hpp>
#include <boost/archive/impl/basic_binary_iarchive.ipp>
#include <boost/archive/impl/basic_binary_iprimitive.ipp>
#include <boost/serialization/array.hpp>
#include <boost/serialization/deque.hpp>
#include <boost/serialization/optional.hpp>
#include <boost/serialization/string.hpp>
#include <boost/serialization/vector.hpp>
#include <sstream>
#include <streambuf>
#include <string>

#include "absl/status/statusor.h"
#include "acoustics/likelihood_scan.h"
#include "frames/frames.h"
#include "geometry/pose.h"
#include "localization/pose_estimate.h"

namespace boost::serialization {

template <class Archive>
void serialize(Archive& archive, soundmap::geometry::Pose2& pose, unsigned) {
  archive& pose.x_m& pose.y_m& pose.yaw_rad;
}

template <class Archive, typename Scalar, int Rows, int Columns>
void serialize(Archive& archive, Eigen::Matrix<Scalar, Rows, Columns>& matrix, unsigned) {
  static_assert(Rows != Eigen::Dynamic && Columns != Eigen::Dynamic);
  for (int i = 0; i < Rows * Columns; ++i) archive& matrix.data()[i];
}

template <class Archive>
void serialize(Archive& archive, soundmap::localization::PoseEstimate& pose, unsigned) {
  archive& pose.stamp_ns& pose.map_from_base& pose.covariance& pose.effective_particles& pose
      .scan_fit& pose.state;
}

template <class Archive>
void serialize(Archive& archive, soundmap::acoustics::Peak& peak, unsigned) {
  archive& peak.direction_in_array& peak.power;
}

template <class Archive>
void serialize(Archive& archive, soundmap::frames::EchoRipple& ripple, unsigned) {
  archive& ripple.waves_per_m& ripple.first_bin& ripple.values;
}

template <class Archive>
void serialize(Archive& archive, soundmap::acoustics::LikelihoodScan& scan, unsigned) {
  archive& scan.begin_ns& scan.end_ns& scan.fault& scan.likelihood& scan.noise_floor& scan
      .peaks& scan.maxima& scan.levels& scan.ripples;
}

template <class Archive>
void serialize(Archive& archive, soundmap::frames::Odometry& odometry, unsigned) {
  archive& odometry.stamp_ns& odometry.odom_from_base;
}

template <class Archive>
void serialize(Archive& archive, soundmap::frames::LidarScan& scan, unsigned) {
  archive& scan.stamp_ns& scan.point_in_lidar& scan.time_offset_ns;
}

template <class Archive>
void serialize(Archive& archive, soundmap::frames::LaserScan& scan, unsigned) {
  archive& scan.stamp_ns& scan.start_angle_rad& scan.angle_increment_rad& scan.range_m;
}

}  // namespace boost::serialization

namespace soundmap::pipeline {

// Appends to a string. A stream, its locale and the archive's codecvt cost more than a pose.
class StringSink : public std::streambuf {
 public:
  explicit StringSink(std::string* out) : out_(out) {}

 protected:
  std::streamsize xsputn(const char* bytes, std::streamsize count) override {
    out_->append(bytes, static_cast<std::size_t>(count));
    return count;
  }
  int_type overflow(int_type byte) override {
    if (byte != traits_type::eof()) out_->push_back(static_cast<char>(byte));
    return byte;
  }

 private:
  std::string* const out_;
};

template <typename... Parts>
std::string ToBytes(const Parts&... parts) {
  std::string bytes;
  StringSink sink(&bytes);
  {
    boost::archive::binary_oarchive archive(sink,
                                            boost::archive::no_header | boost::archive::no_codecvt);
    (archive << ... << parts);
  }
  return bytes;
}

// Boost's own archive believes what it reads: it makes room for as many elements as the bytes say,
// and holds a flag that is neither 0 nor 1 for a fault of the program. Here both are damage.
class CheckedArchive
    : public boost::archive::binary_iarchive_impl<CheckedArchive, char, std::char_traits<char>> {
 public:
  explicit CheckedArchive(std::streambuf& bytes)
      : binary_iarchive_impl(bytes, boost::archive::no_header | boost::archive::no_codecvt),
        bytes_(bytes) {}

  template <typename Value>
  void load_override(Value& value) {
    binary_iarchive_impl::load_override(value);
  }
  // Every element takes a byte or more.
  void load_override(boost::serialization::collection_size_type& size) {
    binary_iarchive_impl::load_override(size);
    CheckLeft(size);
  }
  void load_override(std::string& text) {
    std::size_t size = 0;
    load(size);
    CheckLeft(size);
    text.resize(size);
    load_binary(text.data(), size);
  }
  void load_override(bool& flag) {
    unsigned char byte = 0;
    load(byte);
    if (byte > 1) Refuse();
    flag = byte == 1;
  }

 private:
  [[noreturn]] static void Refuse() {
    throw boost::archive::archive_exception(boost::archive::archive_exception::input_stream_error);
  }
  void CheckLeft(std::size_t size) {
    if (size > static_cast<std::size_t>(std::max<std::streamsize>(bytes_.in_avail(), 0))) Refuse();
  }

  std::streambuf& bytes_;
};

template <typename... Parts>
absl::Status FromBytes(const std::string& bytes, Parts&... parts) {
  // Boost.Serialization reports by exception that the bytes end early or cannot be.
  try {
    std::stringbuf source(bytes, std::ios::in | std::ios::binary);
    CheckedArchive archive(source);
    (archive >> ... >> parts);
  } catch (const std::exception& error) {
    return absl::DataLossError(std::string("stored bytes of the pipeline cannot be read: ") +
                               error.what());
  }
  return absl::OkStatus();
}

}  // namespace soundmap::pipeline

// Arrays of numbers are read at once, as they are written.
BOOST_SERIALIZATION_USE_ARRAY_OPTIMIZATION(soundmap::pipeline::CheckedArchive)
