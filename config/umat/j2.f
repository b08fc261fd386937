C     J2 plasticity with linear isotropic hardening as an Abaqus user
C     material, by radial return with its consistent tangent (Simo and
C     Hughes 1998, box 3.1).  Properties: E, nu, yield stress, hardening
C     modulus.  One state variable, the equivalent plastic strain.
C     Plane strain and solids: NDI = 3.
      SUBROUTINE UMAT(STRESS,STATEV,DDSDDE,SSE,SPD,SCD,
     1 RPL,DDSDDT,DRPLDE,DRPLDT,
     2 STRAN,DSTRAN,TIME,DTIME,TEMP,DTEMP,PREDEF,DPRED,CMNAME,
     3 NDI,NSHR,NTENS,NSTATV,PROPS,NPROPS,COORDS,DROT,PNEWDT,
     4 CELENT,DFGRD0,DFGRD1,NOEL,NPT,LAYER,KSPT,JSTEP,KINC)
C
      INCLUDE 'ABA_PARAM.INC'
C
      CHARACTER*80 CMNAME
      DIMENSION STRESS(NTENS),STATEV(NSTATV),
     1 DDSDDE(NTENS,NTENS),DDSDDT(NTENS),DRPLDE(NTENS),
     2 STRAN(NTENS),DSTRAN(NTENS),TIME(2),PREDEF(1),DPRED(1),
     3 PROPS(NPROPS),COORDS(3),DROT(3,3),DFGRD0(3,3),DFGRD1(3,3),
     4 JSTEP(4)
      DIMENSION FLOW(6)
C
      IF (NPROPS.NE.4 .OR. NSTATV.NE.1 .OR. NDI.NE.3) THEN
        WRITE(0,*) CMNAME(1:20),' needs 4 properties, 1 state variable',
     1   ' and NDI = 3, not ',NPROPS,NSTATV,NDI
        CALL XIT
      END IF
      G=PROPS(1)/(2.D0*(1.D0+PROPS(2)))
      BULK=PROPS(1)/(3.D0*(1.D0-2.D0*PROPS(2)))
      H=PROPS(4)
      SWELL=DSTRAN(1)+DSTRAN(2)+DSTRAN(3)
      P=(STRESS(1)+STRESS(2)+STRESS(3))/3.D0
      SQ=0.D0
      DO K=1,NTENS
        IF (K.LE.3) THEN
          FLOW(K)=STRESS(K)-P+2.D0*G*(DSTRAN(K)-SWELL/3.D0)
          SQ=SQ+FLOW(K)**2
        ELSE
          FLOW(K)=STRESS(K)+G*DSTRAN(K)
          SQ=SQ+2.D0*FLOW(K)**2
        END IF
      END DO
      P=P+BULK*SWELL
      TRIAL=SQRT(1.5D0*SQ)
      OVER=TRIAL-PROPS(3)-H*STATEV(1)
      HOLD=1.D0
      TURN=0.D0
      IF (OVER.GT.0.D0) THEN
        PLAST=OVER/(3.D0*G+H)
        HOLD=1.D0-3.D0*G*PLAST/TRIAL
        TURN=6.D0*G*G*(PLAST/TRIAL-1.D0/(3.D0*G+H))
        SPD=SPD+PLAST*(PROPS(3)+H*(STATEV(1)+0.5D0*PLAST))
        STATEV(1)=STATEV(1)+PLAST
      END IF
      SIZE=1.D0
      IF (SQ.GT.0.D0) SIZE=SQRT(SQ)
      DO K=1,NTENS
        STRESS(K)=HOLD*FLOW(K)
        IF (K.LE.3) STRESS(K)=STRESS(K)+P
        FLOW(K)=FLOW(K)/SIZE
      END DO
      SSE=HOLD*HOLD*SQ/(4.D0*G)+P*P/(2.D0*BULK)
      DO J=1,NTENS
        DO I=1,NTENS
          DDSDDE(I,J)=TURN*FLOW(I)*FLOW(J)
          IF (I.LE.3 .AND. J.LE.3)
     1      DDSDDE(I,J)=DDSDDE(I,J)+BULK-2.D0*G*HOLD/3.D0
          IF (I.EQ.J .AND. I.LE.3) DDSDDE(I,J)=DDSDDE(I,J)+2.D0*G*HOLD
          IF (I.EQ.J .AND. I.GT.3) DDSDDE(I,J)=DDSDDE(I,J)+G*HOLD
        END DO
      END DO
      RETURN
      END
