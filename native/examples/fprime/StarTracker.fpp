module Gnc {

  array F64x3 = [3] F64

  array F64x4 = [4] F64

  array F64x9 = [9] F64

  @ An attitude of the sensor with its covariance; not valid: the numbers are NaN
  port Attitude(
                 stampNs: I64 @< Middle of the exposure
                 valid: bool
                 quaternion: F64x4 @< x, y, z, w: ICRF from sensor
                 covarianceRad2: F64x9 @< Of a rotation vector about sensor axes, row after row
                 rateRadS: F64x3
                 protectionRad: F64x3 @< Bounds of the error about sensor axes
               )

  @ Rate of the sensor by a gyro, about its axes
  port Rate(stampNs: I64, rateRadS: F64x3)

  @ An image: its pixels, 16 bits each, and the middle of its exposure
  port Image(stampNs: I64, ref pixels: Fw.Buffer)

  @ Star images to attitudes
  active component StarTracker {

    async input port image: Image

    async input port rate: Rate

    output port attitude: Attitude

    @ Gives the pixels back
    output port imageDone: Fw.BufferSend

    event port Log

    text event port LogText

    time get port Time

    telemetry port Tlm

    @ The tracker cannot start, or a call of it was wrong
    event Refused(what: string size 32, why: string size 120) severity warning high format "{}: {}"

    @ Numbers of st_reason; that of 600 is an attitude
    telemetry Reason: I32 update on change

    telemetry State: I32 update on change

  }

}
